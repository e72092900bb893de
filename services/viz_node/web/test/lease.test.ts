import { describe, expect, test } from "vitest";
import { leaseOffer } from "../src/lease";
import type { LeaseFacts } from "../src/protocol";
import { Store } from "../src/store";

const ME = "me";
const lease = (changes: Partial<LeaseFacts> = {}): LeaseFacts => ({ number: 7, holder: "", label: "", what: "", kept: false, asking: [], ...changes });
const paul = { holder: "p", label: "Paul", what: "page", kept: true };
const said = (facts: LeaseFacts, role: Parameters<typeof leaseOffer>[2]): string[] => {
  const { text, actions } = leaseOffer(facts, ME, role);
  return [text, ...actions.map((each) => each.text)];
};

describe("the lease of control on the page", () => {
  test("an observer sees who has it and is offered nothing", () => {
    expect(said(lease(paul), "observer")).toEqual(["Paul holds control"]);
    expect(said(lease(), "observer")).toEqual(["Control is free"]);
  });
  test("an operator takes what nobody has, and asks for what another has", () => {
    expect(said(lease(), "operator")).toEqual(["Control is free", "Take"]);
    expect(said(lease(paul), "operator")).toEqual(["Paul holds control", "Ask"]);
    expect(said(lease({ ...paul, asking: [[ME, "Otto"]] }), "operator")).toEqual(["Paul holds control; you have asked and are next"]);
    // what lasts as long as an act is not taken
    expect(said(lease({ holder: ME, label: "Otto" }), "operator")).toEqual(["You hold control for now", "Take"]);
    expect(said(lease({ holder: "x", label: "the program at the rig", what: "program", kept: true }), "operator")).toEqual(["The program at the rig holds control", "Take"]);
  });
  test("who asks is shown to each page that could give the hand, also while it has it for an act alone", () => {
    const asking: [string, string][] = [["q", "Petra"]];
    const forNow = { holder: ME, label: "Otto", what: "page" };
    expect(said(lease({ ...forNow, asking }), "operator")).toEqual(["You hold control for now; Petra asks for it", "Take", "Hand over to Petra"]);
    expect(said(lease({ asking }), "operator")).toEqual(["Control is free; Petra asks for it", "Take"]);
    // a second page of the same address is another page
    const second: [string, string][] = [["me2", "window B"]];
    expect(said(lease({ ...forNow, kept: true, asking: second }), "operator")).toEqual(["You hold control; window B asks for it", "Hand over to window B", "Give up control"]);
  });
  test("a window without a name sees by their letters who holds control and who asks", () => {
    const other = { holder: "a", label: "window A", what: "page", kept: true };
    expect(said(lease(other), "operator")).toEqual(["Window A holds control", "Ask"]);
    expect(said(lease({ ...other, asking: [[ME, "window B"]] }), "operator")).toEqual(["Window A holds control; you have asked and are next"]);
    expect(said(lease({ ...other, asking: [["c", "Nina"], [ME, "window B"]] }), "operator")).toEqual(["Window A holds control; you have asked after Nina"]);
  });
  test("a command names the lease that was taken, and not that of the command before it", () => {
    const store = new Store();
    store.me = ME;
    store.lease = lease({ holder: ME, kept: true });
    expect(store.ownLease).toBe(7);
    store.lease = lease({ holder: ME });
    expect(store.ownLease).toBe(0);
    store.lease = lease(paul);
    expect(store.ownLease).toBe(0);
  });
  test("the lease that an answer names holds at once, and an older tick that comes after it does not", () => {
    const store = new Store();
    store.me = ME;
    store.takeLease(lease({ number: 8, holder: ME, kept: true }));
    store.take({ k: "tick", lease: lease({ number: 7, ...paul }) });
    expect(store.ownLease).toBe(8);
    store.take({ k: "tick", lease: lease({ number: 9, ...paul }) });
    expect(store.ownLease).toBe(0);
  });
  test("control that was lost says how, to the page that lost it and to the others", () => {
    const lost: [string, string] = [ME, "window A was not heard for 1.1 s while it pressed: the tip is withdrawn"];
    expect(said(lease({ lost }), "operator")).toEqual(["This page was not heard for 1.1 s while it pressed: the tip is withdrawn. Control is free", "Take"]);
    expect(said(lease({ lost: ["a", lost[1]] }), "operator")).toEqual(["Window A was not heard for 1.1 s while it pressed: the tip is withdrawn. Control is free", "Take"]);
    expect(said(lease({ lost: [] }), "operator")).toEqual(["Control is free", "Take"]);
  });
  test("who has it hands it over to the first who asks, or lets go", () => {
    const mine = { holder: ME, label: "Otto", what: "page", kept: true };
    expect(said(lease(mine), "operator")).toEqual(["You hold control", "Give up control"]);
    expect(leaseOffer(lease({ ...mine, asking: [["q", "Petra"]] }), ME, "operator")).toEqual({
      text: "You hold control; Petra asks for it",
      actions: [
        { text: "Hand over to Petra", action: "hand_over", to: "q" },
        { text: "Give up control", action: "let_go" },
      ],
    });
  });
});
