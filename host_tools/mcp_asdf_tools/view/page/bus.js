// The robots of a bus: a table with a row for each, and the frames as they pass, through a filter.

import { element, find, shown, write } from "view/panels";

const MOST_FRAMES = 10000;
const MOST_LINES = 300;
/** Of each column of the table in page.html: its text, and whether that is alarming. */
const COLUMNS = [
  [(row) => row.robot],
  [(row) => `${row.seen.toFixed(1)} s`],
  [(row) => row.health ?? "–", (row) => (row.health ?? "nominal") !== "nominal"],
  [(row) => row.mode ?? "–", (row) => (row.mode ?? "operational") !== "operational"],
  [(row) => `${row.rate.toFixed(1)}/s`],
  [(row) => `${(100 * row.loss).toFixed(1)} %`, (row) => row.loss >= 0.01],
  [(row) => row.conflicts, (row) => row.conflicts > 0],
  [(row) => shown(row.x)],
  [(row) => shown(row.b_hat)],
  [(row) => row.updates ?? "–"],
  [(row) => row.jumps],
];

export class Bus {
  /** `onChoose` takes a robot's id. */
  constructor(onChoose) {
    this.onChoose = onChoose;
    this.rows = new Map();
    this.frames = [];
    find("filter").addEventListener("input", () => this.#list());
  }

  /** Takes a report as view/roster.py makes it; no frame says where robots are. O(robots + frames). */
  take({ robots, frames }) {
    document.body.classList.add("bus");
    find("bus").hidden = false;
    const body = find("roster").tBodies[0];
    robots.forEach((row, place) => {
      if (!this.rows.has(row.robot)) {
        const made = this.#row(row.robot);
        this.rows.set(row.robot, made);
        body.insertBefore(made, body.rows[place] ?? null);
      }
      const shownRow = this.rows.get(row.robot);
      shownRow.classList.toggle("silent", row.silent);
      COLUMNS.forEach(([text, isAlarming], column) => {
        const cell = shownRow.cells[column];
        write(column ? cell : cell.firstChild, text(row));
        cell.classList.toggle("alarm", !row.silent && (isAlarming?.(row) ?? false));
      });
    });
    const silent = robots.filter((row) => row.silent).length;
    write(find("roster").caption, `${robots.length} robots, ${silent} silent`);
    this.frames = [...this.frames, ...frames].slice(-MOST_FRAMES);
    this.#list();
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
