const KEY = "telenano-token";

type Place = Pick<Location, "hash" | "pathname" | "search">;
type Past = Pick<History, "replaceState">;
type Kept = Pick<Storage, "getItem" | "setItem">;

/** Where the server takes the socket of a page: beside the page, also where a proxy has it in a sub-folder. */
export function socketUrl(page: string): string {
  const url = new URL("bus", page);
  url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
  return url.href;
}

/**
 * The token of the address that was opened, which is then taken out of the address bar, where a screenshot or a glance
 * would show it. It is kept for this tab alone, so that the page can be loaded again.
 */
export function takeToken(place: Place, past: Past, storage: () => Kept): string {
  const given = place.hash.slice(1);
  if (!given) return remembered(storage);
  past.replaceState(null, "", place.pathname + place.search);
  const token = decoded(given);
  try {
    storage().setItem(KEY, token);
  } catch {
    // a browser that keeps nothing: a person who loads the page again opens its address again
  }
  return token;
}

function remembered(storage: () => Kept): string {
  try {
    return storage().getItem(KEY) ?? "";
  } catch {
    return "";
  }
}

function decoded(text: string): string {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}
