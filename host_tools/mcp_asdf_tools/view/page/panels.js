// What stands beside the arena: figures of the swarm, numbers of one robot, recalibrations.

const MOST_EVENTS = 40;
const WRONG = 0.1;

export const find = (id) => document.getElementById(id);

/** A new element with text and class, if any. */
export function element(name, text = "", className = "") {
  const made = document.createElement(name);
  made.textContent = text;
  if (className) made.className = className;
  return made;
}

/** Writes a text where it differs, so that what stays the same is not drawn again. */
export function write(place, text) {
  if (place.textContent !== String(text)) place.textContent = text;
}

export function shown(value, digits = 3) {
  return value === null || Number.isNaN(value) ? "–" : value.toFixed(digits);
}

function known(values) {
  return values.filter((value) => !Number.isNaN(value));
}

function mean(found) {
  return found.length ? found.reduce((sum, value) => sum + value, 0) / found.length : Number.NaN;
}

/** Four figures of the swarm in a sample, without the robots that are silent or dead. */
export function showFigures(film, sample) {
  const f = film.stage.fill_ratio;
  const robots = film.stage.robots.map((_, robot) => robot);
  const x = known(robots.map((robot) => film.value("x", robot, sample)));
  const judged = known(robots.map((robot) => film.wrongness(robot, sample)));
  const figures = {
    "mean-x": shown(mean(x)),
    "mean-error": f === null ? "–" : shown(mean(x.map((value) => Math.abs(value - f)))),
    spread: shown(x.length ? Math.max(...x) - Math.min(...x) : Number.NaN),
    wrong: judged.length ? `${judged.filter((value) => value > WRONG).length} of ${judged.length}` : "–",
  };
  for (const [name, value] of Object.entries(figures)) write(find(name), value);
}

/** The numbers of the robot that is followed, or how to follow one. */
export function showRobot(film, sample, robot) {
  const [title, list] = find("robot").children;
  if (robot === null) {
    title.textContent =
      "Click a robot, or choose one by the arrow keys, to follow it and to read its numbers";
    list.replaceChildren();
    return;
  }
  const flawed = film.stage.flawed.includes(robot) ? ", flawed at the start" : "";
  title.textContent = `Robot ${film.stage.robots[robot]}${flawed}`;
  const heard = film.heard(sample, robot).map(([sender]) => film.stage.robots[sender]);
  const value = (name) => film.value(name, robot, sample);
  const rows = [
    ["b_hat", shown(value("b_hat"), 4)],
    ["b", shown(value("b"), 4)],
    ["x_hat", shown(value("x_hat"), 4)],
    ["f", shown(film.stage.fill_ratio, 4)],
    ["x", shown(value("x"), 4)],
    ["hears", heard.length > 8 ? `${heard.length} robots` : heard.join(" ") || "–"],
  ];
  list.replaceChildren(...rows.flatMap(([name, text]) => [element("dt", name), element("dd", text)]));
}

/** An event in words, the new b_hat of a recalibration in the colour of what it did. */
function wordsOf(film, { robot, sample, before, after, text }) {
  const who = robot === undefined ? "" : `robot ${film.stage.robots[robot]}: `;
  if (text) return [who + text];
  const truth = film.value("b", robot, sample);
  const isBetter = Math.abs(after - truth) <= Math.abs(before - truth);
  const look = Number.isNaN(truth) ? "" : isBetter ? "better" : "worse";
  return [`${who}b_hat ${before.toFixed(2)} → `, element("span", after.toFixed(2), look)];
}

/** Marks on the time line where faults began or ended, and where robots died or came back. */
export function showMarks(film, total) {
  const canvas = find("marks");
  const key = `${film.events.length} ${total} ${canvas.clientWidth}`;
  if (canvas.dataset.key === key) return;
  canvas.dataset.key = key;
  canvas.width = canvas.clientWidth;
  const context = canvas.getContext("2d");
  context.fillStyle = getComputedStyle(canvas).color;
  for (const { isMark, tick } of film.events) {
    if (isMark) context.fillRect(Math.round((tick / total) * (canvas.width - 2)), 0, 2, canvas.height);
  }
}

/** The last events before a tick; each leads to its time. */
export function showEvents(film, tick, onSeek) {
  const { events } = film;
  const parent = find("events");
  const end = events.findLastIndex((event) => event.tick <= tick) + 1;
  const key = `${end}`;
  const isHeld = parent.dataset.end !== "" && parent.matches(":hover"); // it must not move under the mouse
  if (parent.dataset.end === key || isHeld) return;
  parent.dataset.end = key;
  const list = element("ol");
  for (const event of events.slice(Math.max(0, end - MOST_EVENTS), end).reverse()) {
    const row = element("button");
    row.append(element("time", String(event.tick)), ...wordsOf(film, event));
    row.addEventListener("click", () => onSeek(event));
    const item = element("li");
    item.append(row);
    list.append(item);
  }
  parent.replaceChildren(element("h2", end ? `Events (${end})` : "No recalibration yet"), list);
}
