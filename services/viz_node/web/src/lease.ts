import type { Commands } from "./commands";
import { make } from "./dom";
import type { LeaseFacts, Role } from "./protocol";
import type { Store } from "./store";

export interface LeaseAction {
  text: string;
  action: "ask" | "take" | "hand_over" | "let_go";
  /** The id of whom it is for. */
  to?: string;
}

/** Who holds control, in words, and what this page may do about it; the server decides. */
export function leaseOffer(lease: LeaseFacts, me: string, role: Role): { text: string; actions: LeaseAction[] } {
  const isMine = lease.holder !== "" && lease.holder === me;
  const first = lease.asking.find(([id]) => id !== me);
  const asks = first ? `; ${first[1]} asks for it` : "";
  const mine = lease.kept ? "You hold control" : "You hold control for now";
  const upper = (words: string): string => `${words[0]?.toUpperCase() ?? ""}${words.slice(1)}`;
  const [loser, why] = lease.lost ?? [];
  const free = why ? `${upper(loser === me ? why.replace(/^(window \w+|the operator's page)/, "this page") : why)}. Control is free` : "Control is free";
  const text = isMine ? mine : lease.holder ? `${upper(lease.label)} holds control` : free;
  const actions: LeaseAction[] = [];
  if (role !== "operator") return { text, actions };
  const handOver: LeaseAction[] = first ? [{ text: `Hand over to ${first[1]}`, action: "hand_over", to: first[0] }] : [];
  if (isMine && lease.kept) return { text: text + asks, actions: [...handOver, { text: "Give up control", action: "let_go" }] };
  if (isMine) return { text: text + asks, actions: [{ text: "Take", action: "take" }, ...handOver] };
  if (!lease.holder || lease.what !== "page") return { text: text + asks, actions: [{ text: "Take", action: "take" }] };
  const hasAsked = lease.asking.some(([id]) => id === me);
  const turn = lease.asking[0]?.[0] !== me ? ` after ${lease.asking[0]?.[1]}` : " and are next";
  return { text: hasAsked ? `${text}; you have asked${turn}` : text, actions: hasAsked ? [] : [{ text: "Ask", action: "ask" }] };
}

/** Who holds control, with *Ask*, *Hand over*, *Take* and *Let go*. */
export class LeaseBar {
  readonly root = make("div", { id: "lease", role: "group", "aria-label": "Who holds control" });
  private readonly words = make("span", { id: "lease-text", role: "status" });
  private readonly buttons = make("span", { class: "row tight" });
  private shown = "";

  constructor(
    private readonly commands: Commands,
    private readonly store: Store,
  ) {
    this.root.append(this.words, this.buttons);
  }

  write(): void {
    const { store } = this;
    this.root.hidden = !store.commands || this.commands.link !== "open";
    const { text, actions } = leaseOffer(store.lease, store.me, store.role);
    const key = JSON.stringify([text, actions]);
    if (key === this.shown) return;
    this.shown = key;
    this.words.textContent = text;
    this.root.toggleAttribute("data-asked", text.includes("asks for it"));
    const hadFocus = this.buttons.contains(document.activeElement);
    const made = actions.map(({ text: words, action, to }, i) =>
      make("button", { type: "button", "data-action": action, "aria-keyshortcuts": i ? "" : "h", title: i ? "" : "Key h", onclick: () => void this.want(words, action, to) }, words),
    );
    this.buttons.replaceChildren(...made);
    // a person who works by the keyboard stays where they were
    if (hadFocus) made[0]?.focus();
  }

  /** Do the first of what is offered, by a key. */
  first(): void {
    (this.buttons.firstElementChild as HTMLButtonElement | null)?.click();
  }

  private async want(words: string, action: LeaseAction["action"], to = ""): Promise<void> {
    await this.commands.ask(words, { k: "lease", action, to, lease: this.store.lease.number });
  }
}
