import "./styles.css";

/** What panels and pages of packages may import, as `../../kit.js`: the same modules that the page itself has. */
export { Connection } from "./connection";
export { colour, make, part, quantity, save } from "./dom";
export { ageWords } from "./freshness";
export { ACROSS_M, Hand } from "./hand";
export { numbers } from "./protocol";
export { View } from "./scene";
export { Store } from "./store";
export { Surface } from "./surface";
export { INSTRUMENT } from "./tip";
export { socketUrl, takeToken } from "./token";
