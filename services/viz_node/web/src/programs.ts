/** What the programs of the instrument are called on its buttons, and wherever the page speaks of one; what each does. */
const PROGRAMS: Record<string, readonly [name: string, about: string]> = {
  scan: ["Image", "The instrument takes an image of the sample by itself, line by line"],
  curve: ["Curve", "The tip goes to the sample and back once, and the force is drawn over the distance"],
  tactile: ["Feel along", "The tip goes along a line by itself, and the hand feels its height"],
  push: ["Push", "The tip pushes what lies on the sample along a line by itself"],
};

/** The name of a program on the page; one of a package has its own title. */
export function programName(program: string, title = program): string {
  return PROGRAMS[program]?.[0] ?? title;
}

/** What a program does, in a sentence; one of a package has its own title. */
export function programAbout(program: string, title: string): string {
  return PROGRAMS[program]?.[1] ?? title;
}
