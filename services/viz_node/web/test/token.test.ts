import { describe, expect, test } from "vitest";
import { socketUrl, takeToken } from "../src/token";

class Kept {
  private readonly values = new Map<string, string>();
  getItem(key: string): string | null {
    return this.values.get(key) ?? null;
  }
  setItem(key: string, value: string): void {
    this.values.set(key, value);
  }
}

const shown: unknown[] = [];
const past = { replaceState: (_state: unknown, _title: string, url?: string | URL | null) => shown.push(url) };
const place = (hash: string) => ({ hash, pathname: "/", search: "?a=1" });

describe("the token of the address", () => {
  test("leaves the address bar, and is there when the page is loaded again", () => {
    const kept = new Kept();
    expect(takeToken(place("#secret%2D1"), past, () => kept)).toBe("secret-1");
    expect(shown).toEqual(["/?a=1"]);
    expect(takeToken(place(""), past, () => kept)).toBe("secret-1");
    // the address of a server that was started anew
    expect(takeToken(place("#other"), past, () => kept)).toBe("other");
    expect(takeToken(place(""), past, () => kept)).toBe("other");
  });

  test("is taken where the browser keeps nothing, and one that is none is taken as it is", () => {
    const none = (): never => {
      throw new Error("denied");
    };
    expect(takeToken(place("#secret"), past, none)).toBe("secret");
    expect(takeToken(place(""), past, none)).toBe("");
    expect(takeToken(place("#%E0%A4%A"), past, () => new Kept())).toBe("%E0%A4%A");
  });
});

test("the socket is beside the page, also behind a proxy in a sub-folder", () => {
  expect(socketUrl("http://127.0.0.1:8650/")).toBe("ws://127.0.0.1:8650/bus");
  expect(socketUrl("http://127.0.0.1:8650/participant.html?x=1#token")).toBe("ws://127.0.0.1:8650/bus");
  expect(socketUrl("https://lab.example/rigs/telenano/")).toBe("wss://lab.example/rigs/telenano/bus");
  expect(socketUrl("https://lab.example/rigs/telenano/participant.html#t")).toBe("wss://lab.example/rigs/telenano/bus");
});
