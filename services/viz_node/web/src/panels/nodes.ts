import type { Cockpit, Panel } from "../cockpit";
import { make } from "../dom";
import type { Node } from "../store";
import { fixed } from "../numbers";

const COLUMNS: readonly (readonly [string, string])[] = [
  ["node", "Name and site"],
  ["state", "State that it reports"],
  ["messages a second", "Messages that it published in a second"],
  ["late, ms", "How late its steps begin: 99 of 100 are earlier [ms]"],
  ["judged", "Whether deadlines, losses and refusals are as they should be"],
];
/** Later than this a step of the loop is felt [s], and one of a slow node where it is late by this share of its period. */
const LATE_S = 5e-3;
const LATE_SHARE = 0.5;
const LOST_MANY = 10;

/** What the numbers of a node say, in words: good, to watch, or bad, and why. */
export function judged(node: Pick<Node, "state" | "overruns" | "lost" | "rejected" | "lateness_p99_s" | "uptime_s" | "rate_hz">, rests = false): [kind: "" | "warn", text: string] {
  const steps = Math.max(1, node.uptime_s * Math.max(1, node.rate_hz));
  const share = node.overruns / steps;
  const found: string[] = [];
  if (share > 0.01) found.push(`${fixed(100 * share, 0)} % of its deadlines missed`);
  if (node.lateness_p99_s > Math.max(LATE_S, LATE_SHARE / Math.max(1, node.rate_hz))) found.push("late");
  if (node.lost > LOST_MANY) found.push(`${node.lost} messages lost`);
  if (found.length) return ["warn", found.join(", ")];
  if (node.state === "safe" && rests) return ["", "idle while the instrument runs a program"];
  if (node.state === "safe") return ["warn", "idle: it receives no command"];
  // refused are messages from before a start or of an older session: that is what a guard is for
  const notes = [node.overruns ? `${node.overruns} late` : "", node.lost ? `${node.lost} lost` : "", node.rejected ? `${node.rejected} outdated refused` : ""].filter(Boolean);
  return ["", notes.length ? `good (${notes.join(", ")})` : "good"];
}

/** The nodes of the rig, and whether each does what it should. */
export class NodesPanel implements Panel {
  private readonly rows = make("tbody");

  constructor(
    root: HTMLElement,
    private readonly cockpit: Cockpit,
  ) {
    const head = COLUMNS.map(([name, about]) => make("th", { title: about, scope: "col" }, name));
    root.append(make("table", {}, make("thead", {}, make("tr", {}, ...head)), this.rows));
  }

  write(): void {
    const { store } = this.cockpit;
    const lost = new Set(store.lost());
    const rows = [...store.nodes].sort(([a], [b]) => a.localeCompare(b)).map(([name, node]) => {
      const isLost = lost.has(name);
      const [warns, words] = judged(node, this.cockpit.tip.program !== "");
      const kind = isLost || node.state === "stopping" ? "bad" : warns;
      const late = node.lateness_p99_s > 0 ? fixed(node.lateness_p99_s * 1e3, 2) : "";
      const cells = [name, isLost ? "lost" : node.state, fixed(node.rate_hz, 0), late, isLost ? "no report arrives" : words];
      const about = `overruns ${node.overruns}, lost ${node.lost}, refused ${node.rejected}, processor ${fixed(node.cpu_percent, 0)} %`;
      return make("tr", { class: kind, title: about }, ...cells.map((cell) => make("td", {}, cell)));
    });
    this.rows.replaceChildren(...rows);
  }
}
