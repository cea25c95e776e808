// The robots of a bus: a table with a row for each robot, and the frames as they pass, through a filter.

import { createElement, findElement, formatValue, writeText } from "view/panels";

const MAX_KEPT_FRAMES = 10000;
const MAX_SHOWN_FRAMES = 300;
const ALARMING_LOSS = 0.01;
/** The columns of the table in page.html: the text of each, and whether it is alarming. */
const COLUMNS = [
  { text: (row) => row.robot },
  { text: (row) => `${row.seen.toFixed(1)} s` },
  { text: (row) => row.health ?? "–", isAlarming: (row) => (row.health ?? "nominal") !== "nominal" },
  { text: (row) => row.mode ?? "–", isAlarming: (row) => (row.mode ?? "operational") !== "operational" },
  { text: (row) => `${row.rate.toFixed(1)}/s` },
  { text: (row) => `${(100 * row.loss).toFixed(1)} %`, isAlarming: (row) => row.loss >= ALARMING_LOSS },
  { text: (row) => row.conflicts, isAlarming: (row) => row.conflicts > 0 },
  { text: (row) => formatValue(row.x) },
  { text: (row) => formatValue(row.b_hat) },
  { text: (row) => row.updates ?? "–" },
  { text: (row) => row.jumps },
];

/** Returns whether a frame's sender or text has a word of the filter: a number is a robot's id. */
function matchesWord(word, robot, text) {
  return /^\d+$/.test(word) ? robot === Number(word) : text.includes(word);
}

export class Bus {
  /** Prepares the table and the list; `onChoose` is called with the id of a robot that a user chooses. */
  constructor(onChoose) {
    this.onChoose = onChoose;
    this.tableRows = new Map();
    this.frames = [];
    findElement("filter").addEventListener("input", () => this.#listFrames());
  }

  /** Shows a report, as `Roster.report` makes it, in place of the arena. O(robots + frames). */
  showReport({ robots, frames }) {
    document.body.classList.add("bus");
    findElement("bus").hidden = false;
    const tableBody = findElement("roster").tBodies[0];
    robots.forEach((row, index) => {
      if (!this.tableRows.has(row.robot)) {
        const tableRow = this.#createRow(row.robot);
        this.tableRows.set(row.robot, tableRow);
        // The report is sorted by id, and so are the rows before this one.
        tableBody.insertBefore(tableRow, tableBody.rows[index] ?? null);
      }
      this.#fillRow(this.tableRows.get(row.robot), row);
    });
    const silentCount = robots.filter((row) => row.silent).length;
    writeText(findElement("roster").caption, `${robots.length} robots, ${silentCount} silent`);
    this.frames = [...this.frames, ...frames].slice(-MAX_KEPT_FRAMES);
    this.#listFrames();
  }

  /** Returns an empty row for a robot, whose id is a button that chooses the robot. */
  #createRow(robotId) {
    const tableRow = createElement("tr");
    const head = createElement("th");
    head.scope = "row";
    const button = createElement("button");
    button.type = "button";
    button.title = "follow";
    button.addEventListener("click", () => this.onChoose(robotId));
    head.append(button);
    tableRow.append(head, ...COLUMNS.slice(1).map(() => createElement("td")));
    return tableRow;
  }

  #fillRow(tableRow, row) {
    tableRow.classList.toggle("silent", row.silent);
    COLUMNS.forEach(({ text, isAlarming }, column) => {
      const cell = tableRow.cells[column];
      const textElement = column === 0 ? cell.firstChild : cell; // the first cell has the button
      writeText(textElement, text(row));
      cell.classList.toggle("alarm", !row.silent && (isAlarming?.(row) ?? false));
    });
  }

  /** Marks the row of the robot with this id, or none if it is undefined. */
  follow(robotId) {
    for (const [id, tableRow] of this.tableRows) {
      const button = tableRow.firstChild.firstChild;
      button.setAttribute("aria-pressed", id === robotId);
    }
  }

  /** Lists the frames that have all words of the filter, the latest first. */
  #listFrames() {
    // Lines must not move away while somebody reads or selects them.
    if (findElement("frames").matches(":hover")) return;
    const words = findElement("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
    const matchingFrames = this.frames.filter(([, robot, text]) =>
      words.every((word) => matchesWord(word, robot, text)),
    );
    const lines = matchingFrames.slice(-MAX_SHOWN_FRAMES).map(([seconds, robot, text]) => {
      const time = seconds.toFixed(3).padStart(9);
      return `${time} s  ${robot ?? "–"}  ${text}`;
    });
    findElement("frames").textContent = lines.reverse().join("\n");
  }
}
