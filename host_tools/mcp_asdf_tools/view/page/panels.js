// What stands around the arena: figures of the swarm, numbers of one robot, events, marks on the time line.

import { colour } from "view/colours";

const MOST_EVENTS = 40;
const WRONG = 0.1;

/** A new element with text and class, if any. */
function element(name, text = "", className = "") {
  const made = document.createElement(name);
  made.textContent = text;
  if (className) made.className = className;
  return made;
}

function shown(value, digits = 3) {
  return value === null || Number.isNaN(value) ? "–" : value.toFixed(digits);
}

function mean(values) {
  const found = values.filter((value) => !Number.isNaN(value));
  return found.length ? found.reduce((sum, value) => sum + value, 0) / found.length : Number.NaN;
}

/** Four figures of the swarm in a sample. */
export function showFigures(parent, film, sample) {
  const f = film.stage.fillRatio;
  const robots = film.stage.robots.map((_, robot) => robot);
  const x = robots.map((robot) => film.value("x", robot, sample));
  const wrong = robots.map((robot) => film.wrongness(robot, sample));
  const isKnown = wrong.some((value) => !Number.isNaN(value));
  const figures = [
    ["mean x", shown(mean(x)), f === null ? "" : ` (f = ${f})`],
    ["mean error", f === null ? "–" : shown(mean(x.map((value) => Math.abs(value - f)))), ""],
    ["spread of x", shown(Math.max(...x) - Math.min(...x)), ""],
    [
      "wrong b_hat",
      isKnown ? `${wrong.filter((value) => value > WRONG).length} of ${robots.length}` : "–",
      "",
    ],
  ];
  if (parent.children.length !== figures.length) {
    parent.replaceChildren(
      ...figures.map(() => {
        const box = element("div");
        box.append(element("b"), element("span"));
        return box;
      }),
    );
    parent.children[3].title = `robots whose b_hat is off by more than ${WRONG}`;
  }
  figures.forEach(([name, value, more], index) => {
    const [number, label] = parent.children[index].children;
    if (number.textContent !== value) number.textContent = value;
    if (label.textContent !== name + more) label.textContent = name + more;
  });
}

/** The numbers of the robot that is followed, or how to follow one. */
export function showRobot(parent, film, sample, robot, onClose) {
  if (robot === null) {
    if (parent.dataset.robot === "none") return;
    parent.dataset.robot = "none";
    parent.replaceChildren(
      element("h2", "No robot chosen"),
      element("p", "Click a robot to follow it and to read its numbers."),
    );
    return;
  }
  if (parent.dataset.robot !== String(robot)) {
    parent.dataset.robot = String(robot);
    const isFlawed = film.stage.flawed.includes(robot);
    const close = element("button", "×", "close");
    close.title = "follow no robot (escape)";
    close.addEventListener("click", onClose);
    const title = `Robot ${film.stage.robots[robot]}${isFlawed ? ", flawed at the start" : ""}`;
    parent.replaceChildren(close, element("h2", title), element("dl"));
  }
  const heard = film.stage.robots.filter((_, sender) => film.hears(robot, sender, sample));
  const value = (name) => film.value(name, robot, sample);
  const rows = [
    ["b_hat", shown(value("b_hat"), 4)],
    ["b", shown(value("b"), 4)],
    ["x_hat", shown(value("x_hat"), 4)],
    ["f", shown(film.stage.fillRatio, 4)],
    ["x", shown(value("x"), 4)],
    ["hears", film.robots > 30 && heard.length > 8 ? `${heard.length} robots` : heard.join(" ") || "–"],
  ];
  if (film.moves) {
    const [x, y] = film.position(robot, sample);
    rows.push(["east", `${x.toFixed(2)} m`], ["north", `${y.toFixed(2)} m`]);
  }
  parent.lastElementChild.replaceChildren(
    ...rows.flatMap(([name, text]) => [element("dt", name), element("dd", text)]),
  );
}

/** The last events before a tick; each leads to its time. */
export function showEvents(parent, film, events, tick, onSeek) {
  const end = events.findLastIndex((event) => event.tick <= tick) + 1;
  const key = `${end}`;
  if (parent.dataset.end === key) return;
  parent.dataset.end = key;
  const list = element("ol");
  for (const event of events.slice(Math.max(0, end - MOST_EVENTS), end).reverse()) {
    const truth = film.value("b", event.robot, event.sample);
    const isBetter = Math.abs(event.after - truth) <= Math.abs(event.before - truth);
    const row = element("button");
    row.append(
      element("time", String(event.tick)),
      `robot ${film.stage.robots[event.robot]}: b_hat ${event.before.toFixed(2)} → `,
      element("span", event.after.toFixed(2), Number.isNaN(truth) ? "" : isBetter ? "better" : "worse"),
    );
    row.addEventListener("click", () => onSeek(event));
    const item = element("li");
    item.append(row);
    list.append(item);
  }
  parent.replaceChildren(element("h2", end ? `Recalibrations (${end})` : "No recalibration yet"), list);
}

/** A mark under the time line for each event. */
export function showMarks(canvas, film, events, total) {
  const ratio = window.devicePixelRatio || 1;
  canvas.width = Math.max(1, canvas.clientWidth * ratio);
  canvas.height = Math.max(1, canvas.clientHeight * ratio);
  const context = canvas.getContext("2d");
  for (const { tick, robot, sample, after } of events) {
    const truth = film.value("b", robot, sample);
    context.fillStyle = colour(Math.abs(after - truth) > WRONG ? "wrong" : "right");
    context.fillRect((tick / total) * canvas.width - ratio, 0, 2 * ratio, canvas.height);
  }
}

/** What the colours and shapes mean. */
export function showLegend(parent, film) {
  const entries = [
    ["scale", "b_hat right … off by 0.4"],
    ["ring", "flawed at the start"],
    ["line", "hear each other"],
    ["dot", "a message"],
  ];
  const isMoving = film.moves ? entries : entries.filter(([name]) => name !== "line");
  parent.replaceChildren(
    ...isMoving.map(([name, text]) => {
      const entry = element("span");
      entry.append(element("i", "", name), text);
      return entry;
    }),
  );
}
