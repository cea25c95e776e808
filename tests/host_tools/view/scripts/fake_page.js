// What the scripts of the page need of a browser, so that their results can be read without one.

import { History, ONE } from "view/history";

/** An element of a page, as far as the scripts fill in texts and lists. */
export class FakeElement {
  constructor(name) {
    this.name = name;
    this.textContent = "";
    this.className = "";
    this.classes = new Set();
    this.children = [];
    this.dataset = {};
    this.style = {};
  }

  append(...children) {
    this.children.push(...children);
  }

  replaceChildren(...children) {
    this.children = children;
  }

  insertBefore(child, next) {
    this.children.splice(next === null ? this.children.length : this.children.indexOf(next), 0, child);
  }

  addEventListener() {}

  get classList() {
    const { classes } = this;
    return {
      add: (name) => classes.add(name),
      toggle: (name, isOn) => (isOn ? classes.add(name) : classes.delete(name)),
    };
  }

  get firstChild() {
    return this.children[0];
  }

  get rows() {
    return this.children; // of a table
  }

  get cells() {
    return this.children; // of a row
  }

  matches() {
    return false; // no mouse is over it
  }

  /** The text of the element and of all elements in it. */
  get text() {
    return this.textContent + this.children.map((child) => child.text ?? child).join("");
  }
}

/** What a history has of each robot. */
const QUANTITIES = ["x", "x_hat", "b_hat", "b"];

const elementsById = new Map();

/** Returns the element with an id, which is made when it is asked for the first time. */
export function element(id) {
  if (!elementsById.has(id)) elementsById.set(id, new FakeElement(id));
  return elementsById.get(id);
}

/** The colours of the style sheet, which `getComputedStyle` computes. */
const COLOURS = {
  right: "rgb(0, 0, 255)",
  wrong: "rgb(255, 100, 0)",
  soft: "rgb(1, 2, 3)",
  none: "rgb(122, 134, 148)",
};

globalThis.document = {
  body: new FakeElement("body"),
  createElement: (name) => new FakeElement(name),
  getElementById: element,
};
globalThis.getComputedStyle = ({ style }) => ({
  outlineColor: COLOURS[/var\(--(.*)\)/.exec(style.outlineColor)[1]],
});

/** Returns values as a column of a history has them, with null for what is unknown. */
export function encode(values) {
  return Uint16Array.from(values, (value) => (value === null ? 65535 : Math.round(value * ONE)));
}

/**
 * Returns a history of robots that do not move and, without links, hear nobody.
 *
 * A quantity has the values of all robots in the first state, then those in the second, and so on, with null for
 * what is unknown; a quantity that is left out is unknown. Links, the same in all states, are receiver, sender,
 * receiver, sender and so on. Further fields replace those of the description.
 */
export function makeHistory({ robots, ticks, quantities, links = [], ...fields }) {
  const description = {
    title: "a run",
    robots,
    flawed: [],
    quantities: QUANTITIES,
    fill_ratio: null,
    steps: ticks.at(-1),
    steps_per_second: 10,
    sides: null,
    floor: null,
    filter: null,
    unfiltered_errors: [],
    ...fields,
  };
  const history = new History(description);
  const unknown = new Array(robots.length * ticks.length).fill(null);
  const columns = QUANTITIES.map((name) => [name, encode(quantities[name] ?? unknown)]);
  history.appendStates({
    ticks: Uint32Array.from(ticks),
    columns: Object.fromEntries(columns),
    links: ticks.map(() => Uint16Array.from(links)),
  });
  return history;
}

/** Returns a value rounded to four digits, finer than the 16 bits of a history; null and NaN as they are. */
export function round(value) {
  return typeof value === "number" ? Number(value.toFixed(4)) : value;
}
