// The robots of a bus: a table with a row for each, and the frames as they pass, through a filter.

import { element, find, shown } from "view/panels";

const MOST_FRAMES = 10000;
const MOST_LINES = 300;
const COLUMNS = [
  ["robot", "id", (row) => row.robot],
  ["seen", "seconds since its last frame; silent from 3 s on", (row) => `${row.seen.toFixed(1)} s`],
  ["health", "of its last heartbeat", (row) => row.health ?? "–"],
  ["mode", "of its last heartbeat", (row) => row.mode ?? "–"],
  ["rate", "estimates a second, over 5 s", (row) => `${row.rate.toFixed(1)}/s`],
  [
    "loss",
    "share of its frames that is missing by transfer ids",
    (row) => `${(100 * row.loss).toFixed(1)} %`,
  ],
  ["conflicts", "heartbeats of another node with its id", (row) => row.conflicts],
  ["x", "of its last telemetry", (row) => shown(row.x, 3)],
  ["b_hat", "of its last telemetry", (row) => shown(row.b_hat, 3)],
  ["updates", "of b_hat, modulo 256", (row) => row.updates ?? "–"],
  ["jumps", "estimates whose alpha is at least twice or at most half the one before", (row) => row.jumps],
];
const ALARMS = {
  health: (row) => row.health !== null && row.health !== "nominal",
  mode: (row) => row.mode !== null && row.mode !== "operational",
  loss: (row) => row.loss >= 0.01,
  conflicts: (row) => row.conflicts > 0,
};

/** Writes a text where it differs, so that what stays the same is not drawn again. */
function write(place, text) {
  if (place.textContent !== String(text)) place.textContent = text;
}

export class Bus {
  /** `onChoose` takes a robot's id. */
  constructor(onChoose) {
    this.onChoose = onChoose;
    this.rows = new Map();
    this.frames = [];
    find("filter").addEventListener("input", () => this.#list());
  }

  /** Takes a report as view/roster.py makes it. O(robots + frames). */
  take({ robots, frames }) {
    if (!find("roster").tHead) this.#begin();
    const body = find("roster").tBodies[0];
    robots.forEach((row, place) => {
      if (!this.rows.has(row.robot)) {
        const made = this.#row(row.robot);
        this.rows.set(row.robot, made);
        body.insertBefore(made, body.rows[place] ?? null);
      }
      const shownRow = this.rows.get(row.robot);
      shownRow.classList.toggle("silent", row.silent);
      COLUMNS.forEach(([name, , text], column) => {
        const cell = shownRow.cells[column];
        write(column ? cell : cell.firstChild, text(row));
        cell.classList.toggle("alarm", !row.silent && (ALARMS[name]?.(row) ?? false));
      });
    });
    const silent = robots.filter((row) => row.silent).length;
    write(find("roster").caption, `${robots.length} robots, ${silent} silent`);
    this.frames = [...this.frames, ...frames].slice(-MOST_FRAMES);
    this.#list();
  }

  /** Shows the table in place of the arena: no frame says where robots are. */
  #begin() {
    document.body.classList.add("bus");
    find("bus").hidden = false;
    const table = find("roster");
    table.createCaption();
    const head = table.createTHead().insertRow();
    for (const [name, meaning] of COLUMNS) {
      head.append(Object.assign(element("th", name), { scope: "col", title: meaning }));
    }
    table.createTBody();
  }

  #row(robot) {
    const row = element("tr");
    const head = Object.assign(element("th"), { scope: "row" });
    const button = Object.assign(element("button"), { type: "button", title: "follow" });
    button.addEventListener("click", () => this.onChoose(robot));
    head.append(button);
    row.append(head, ...COLUMNS.slice(1).map(() => element("td")));
    return row;
  }

  /** Marks the row of a robot, or none. */
  follow(robot) {
    for (const [id, row] of this.rows) row.firstChild.firstChild.setAttribute("aria-pressed", id === robot);
  }

  /** The frames that the filter lets through, the latest first; they stay while the mouse is on them. */
  #list() {
    if (find("frames").matches(":hover")) return;
    const words = find("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
    const passes = (robot, text) => (word) =>
      /^\d+$/.test(word) ? robot === Number(word) : text.includes(word);
    const lines = this.frames
      .filter(([, robot, text]) => words.every(passes(robot, text)))
      .slice(-MOST_LINES)
      .map(([seconds, robot, text]) => `${seconds.toFixed(3).padStart(9)} s  ${robot ?? "–"}  ${text}`);
    find("frames").textContent = lines.reverse().join("\n");
  }
}
