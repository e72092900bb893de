import type { Cockpit } from "./cockpit";
import { make, part } from "./dom";
import { fixed } from "./numbers";

const MENU = "recording-files";

/** A file of the recording, as the server has it. */
export interface RecordingFile {
  name: string;
  size_bytes: number;
  is_finished: boolean;
  /** Why it cannot be had; empty where it can. */
  why: string;
}

export interface RecordingFacts {
  files: RecordingFile[];
  /** Why there is none, and which command gets it; empty where there are files. */
  why: string;
}

/** A row of the list: a button for a file, off where that cannot be had, and a sentence beside it. */
export interface RecordingRow {
  name: string;
  isOff: boolean;
  words: string;
}

/** A size in the unit that suits it. */
export function sizeText(bytes: number): string {
  if (bytes < 1e6) return `${fixed(bytes / 1e3, 0)} kB`;
  return bytes < 1e9 ? `${fixed(bytes / 1e6, 1)} MB` : `${fixed(bytes / 1e9, 2)} GB`;
}

/** The rows for what the server answered, newest file first; a sentence is why it gave none. */
export function rowsOf(found: RecordingFacts | string): RecordingRow[] {
  if (typeof found === "string") return [{ name: "", isOff: true, words: found }];
  if (!found.files.length) return [{ name: "", isOff: true, words: found.why }];
  return found.files.map(({ name, size_bytes, is_finished, why }) => {
    const state = is_finished ? "finished" : "so far: it is being written, and can be read as far as it goes (telenano view, mcap recover)";
    return { name, isOff: why !== "", words: why || `${sizeText(size_bytes)}, ${state}` };
  }).reverse();
}

/** Why this page cannot have the recording, whatever the server has; empty where it may ask. */
export function whyNot({ commands, store }: Pick<Cockpit, "commands" | "store">): string {
  if (commands.link !== "open") return "This page is not connected";
  return store.role === "operator" ? "" : "Only the page of an operator gets the file of the recording";
}

/** Ask for an address that is valid once, and let the browser save what is there; return why it cannot, or nothing. */
export async function download(connection: Pick<Cockpit["connection"], "ask">, name: string, open: (url: string) => void): Promise<string> {
  const answer = await connection.ask({ k: "recording", name });
  if (!answer.ok) return answer.text;
  open(new URL((answer.found as { address: string }).address, document.baseURI).href);
  return "";
}

/** Open the list of the files, which stands beside *Save PNG*, from elsewhere on the page. */
export function openRecording(): void {
  const menu = part(MENU) as HTMLDetailsElement;
  if (document.body.dataset["place"] === "controls") part("place-scopes").click();
  menu.open = true;
  menu.querySelector("summary")!.focus();
}

/** The files of the recording behind a button; what there is is asked for when it is opened. */
export function recordingMenu(cockpit: Cockpit): HTMLDetailsElement {
  const { commands, connection } = cockpit;
  const list = make("div", { class: "sheet" });
  const menu = make("details", { class: "menu recording-files", id: MENU }, make("summary", { title: "Save the file of the recording (.mcap)" }, "Recording"), list);
  const save = async (name: string): Promise<void> => {
    const why = await download(connection, name, (url) => make("a", { href: url, download: "" }).click());
    if (why) commands.show(`save ${name}`, false, why);
    else menu.open = false;
  };
  const show = (found: RecordingFacts | string): void => {
    list.replaceChildren(...rowsOf(found).map(({ name, isOff, words }) => {
      const button = make("button", { type: "button", disabled: isOff, onclick: () => void save(name) }, name || "Save .mcap");
      return make("div", {}, button, make("p", {}, words));
    }));
  };
  menu.addEventListener("toggle", () => {
    if (!menu.open) return;
    const why = whyNot(cockpit);
    show(why || "The files are being listed");
    if (!why) void connection.ask({ k: "recording" }).then(({ ok, text, found }) => show(ok ? (found as RecordingFacts) : text));
  });
  return menu;
}
