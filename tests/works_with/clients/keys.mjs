// Keys for a program in Node: zeromq has CURVE, and leaves key files, Z85 and the authentication by ZAP to its caller.
import { readFileSync } from "node:fs";

const DIGITS = "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ.-:+=^!/*?&<>()[]{}@%$#";
const number = (five) => [...five].reduce((sum, each) => 85 * sum + DIGITS.indexOf(each), 0);
const hexOf = (key) => key.match(/.{5}/g).map((five) => number(five).toString(16).padStart(8, "0")).join("");

export function keysOf(file) { // the pair of a file NAME.key_secret
  const content = readFileSync(file, "utf8");
  const [publicKey, secretKey] = ["public", "secret"].map((kind) => content.match(`${kind}-key = "(.{40})"`)[1]);
  return { publicKey, secretKey };
}
export async function admit(zap, keys) { // answers for each connection whether its key is one of these
  const known = keys.map(hexOf);
  for await (const [, id, , , , , key] of zap)
    await zap.send(["1.0", id, key && known.includes(key.toString("hex")) ? "200" : "400", "", "", ""]);
}
