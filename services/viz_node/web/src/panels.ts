import type { Cockpit, PanelRow } from "./cockpit";
import { DelayPanel } from "./panels/delay";
import { EventsPanel } from "./panels/events";
import { HandPanel } from "./panels/hand";
import { HelpPanel } from "./panels/help";
import { ImagePanel } from "./panels/image";
import { InstrumentPanel } from "./panels/instrument";
import { LawPanel } from "./panels/law";
import { LinkPanel } from "./panels/link";
import { NodesPanel } from "./panels/nodes";
import { ScenePanel } from "./panels/scene";
import { ScopesPanel } from "./panels/scopes";
import { SessionPanel } from "./panels/session";
import { SettingsPanel } from "./panels/settings";
import { SummaryPanel } from "./panels/summary";
import { TimelinePanel } from "./panels/timeline";

const isLive = ({ store }: Cockpit): boolean => store.commands;
const isRecording = ({ store }: Cockpit): boolean => store.source.kind === "recording";

/** Every panel of the page itself in the order of its region: one file, and one row here. Those of packages come after. */
export const PANELS: readonly PanelRow[] = [
  { id: "recording", title: "Recording", region: "timeline", shows: isRecording, make: (root, cockpit) => new TimelinePanel(root, cockpit) },
  { id: "scene", title: "Image and tip in space", region: "stage", make: (root, cockpit) => new ScenePanel(root, cockpit) },
  { id: "hand", title: "Hand and tip", region: "stage", make: (root, cockpit) => new HandPanel(root, cockpit) },
  { id: "curves", title: "Scopes", region: "scopes", make: (root, cockpit) => new ScopesPanel(root, cockpit) },
  { id: "session", title: "Session", region: "controls", shows: isLive, make: (root, cockpit) => new SessionPanel(root, cockpit) },
  { id: "instrument", title: "Instrument", region: "controls", shows: (cockpit) => cockpit.tip.isThere, make: (root, cockpit) => new InstrumentPanel(root, cockpit) },
  { id: "law", title: "Law", region: "controls", shows: isLive, make: (root, cockpit) => new LawPanel(root, cockpit) },
  { id: "link", title: "Link", region: "controls", shows: isLive, make: (root, cockpit) => new LinkPanel(root, cockpit) },
  { id: "summary", title: "Summary", region: "dock", shows: isRecording, make: (root, cockpit) => new SummaryPanel(root, cockpit) },
  { id: "help", title: "Help", region: "dock", make: (root, cockpit) => new HelpPanel(root, cockpit) },
  { id: "image", title: "Image", region: "dock", make: (root, cockpit) => new ImagePanel(root, cockpit) },
  { id: "gallery", title: "Delay", region: "dock", make: (root, cockpit) => new DelayPanel(root, cockpit) },
  { id: "settings", title: "Settings", region: "dock", shows: isLive, make: (root, cockpit) => new SettingsPanel(root, cockpit) },
  { id: "nodes", title: "Nodes", region: "watch", make: (root, cockpit) => new NodesPanel(root, cockpit) },
  { id: "events", title: "Events", region: "watch", pane: true, make: (root, cockpit) => new EventsPanel(root, cockpit) },
];
