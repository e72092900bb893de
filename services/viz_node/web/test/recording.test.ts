import { afterEach, expect, it, vi } from "vitest";
import { download, rowsOf, sizeText, whyNot, type RecordingFile } from "../src/recording";

const file = (changes: Partial<RecordingFile> = {}): RecordingFile => ({ name: "session.mcap", size_bytes: 12_340_000, is_finished: true, why: "", ...changes });

afterEach(() => vi.unstubAllGlobals());

it("offers each file with its size, the newest first, and says which is still being written", () => {
  const rows = rowsOf({ files: [file(), file({ name: "session_1.mcap", size_bytes: 900, is_finished: false })], why: "" });
  expect(rows.map(({ name, isOff }) => [name, isOff])).toEqual([["session_1.mcap", false], ["session.mcap", false]]);
  expect(rows[1]!.words).toBe("12.3 MB, finished");
  expect(rows[0]!.words).toMatch(/^1 kB, so far: .*can be read as far as it goes/);
});

it("is off, with the reason, where a file cannot be read, there is none here, or the server refuses", () => {
  const [unreadable] = rowsOf({ files: [file({ why: "session.mcap is a symbolic link, which is not followed" })], why: "" });
  expect(unreadable).toEqual({ name: "session.mcap", isOff: true, words: "session.mcap is a symbolic link, which is not followed" });
  const elsewhere = "the file is where the recorder runs: copy it with `docker cp`";
  expect(rowsOf({ files: [], why: elsewhere })).toEqual([{ name: "", isOff: true, words: elsewhere }]);
  expect(rowsOf("try again in a moment")).toEqual([{ name: "", isOff: true, words: "try again in a moment" }]);
});

it("asks nothing of a server that would refuse, or is not there", () => {
  const why = (link: string, role: string): string => whyNot({ commands: { link }, store: { role } } as never);
  expect(why("open", "operator")).toBe("");
  expect(why("open", "observer")).toMatch(/^Only the page of an operator/);
  expect(why("lost", "operator")).toBe("This page is not connected");
});

it("opens the address that it was given, beside the page and without its token, and says why it got none", async () => {
  vi.stubGlobal("document", { baseURI: "https://lab.example/rig/#secret-token" });
  const opened: string[] = [];
  const asked: object[] = [];
  const connection = (answer: object): never => ({ ask: async (fields: object) => (asked.push(fields), answer) }) as never;
  const open = (url: string): void => void opened.push(url);
  expect(await download(connection({ ok: true, found: { address: "recording/abc_-1" } }), "session.mcap", open)).toBe("");
  expect(opened).toEqual(["https://lab.example/rig/recording/abc_-1"]);
  expect(asked).toEqual([{ k: "recording", name: "session.mcap" }]);
  expect(await download(connection({ ok: false, text: "session.mcap cannot be read: Permission denied" }), "session.mcap", open)).toMatch(/Permission denied/);
  expect(opened).toHaveLength(1);
});

it("gives a size in the unit that suits it", () => {
  expect([900, 999_999, 1e6, 2.5e9].map(sizeText)).toEqual(["1 kB", "1000 kB", "1.0 MB", "2.50 GB"]);
});
