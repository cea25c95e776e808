// What stands beside the arena: figures of the swarm, numbers of one robot, events; and helpers for elements.

import { colourOfError } from "view/colours";

const MAX_SHOWN_EVENTS = 40;
const MAX_SHOWN_SENDERS = 8;
const LARGE_ERROR = 0.1; // of a b_hat that counts as wrong

/** Returns the element of the page with this id. */
export const findElement = (id) => document.getElementById(id);

/** Returns a new element with a text and a class. */
export function createElement(name, text = "", className = "") {
  const element = document.createElement(name);
  element.textContent = text;
  if (className) element.className = className;
  return element;
}

/** Writes a text into an element unless it is there already, since each write makes the browser lay out again. */
export function writeText(element, text) {
  if (element.textContent !== String(text)) element.textContent = text;
}

/** Returns a value as text with some digits after the point, or a dash if it is null or NaN. */
export function formatValue(value, digits = 3) {
  return value === null || Number.isNaN(value) ? "–" : value.toFixed(digits);
}

function removeUnknown(values) {
  return values.filter((value) => !Number.isNaN(value));
}

/** Returns the mean of values; NaN of none. */
function mean(values) {
  if (values.length === 0) return Number.NaN;
  return values.reduce((sum, value) => sum + value, 0) / values.length;
}

/** Returns the estimates x in a state of all robots that do not lie, are not silent and not dead. */
function estimatesOf(history, state) {
  const { robots, liars = [] } = history.description;
  const x = robots.map((_, robot) => (liars.includes(robot) ? Number.NaN : history.value("x", robot, state)));
  return removeUnknown(x);
}

/** Returns the mean of the estimates in a state; NaN if there are none. */
export function meanEstimate(history, state) {
  return mean(estimatesOf(history, state));
}

/** Shows four figures of the swarm in a state; robots that are silent or dead do not count. */
export function showFigures(history, state) {
  const fillRatio = history.description.fill_ratio;
  const robots = history.description.robots.map((_, robot) => robot);
  const x = estimatesOf(history, state);
  const bHatErrors = removeUnknown(robots.map((robot) => history.bHatError(robot, state)));
  const meanError = fillRatio === null ? null : mean(x.map((value) => Math.abs(value - fillRatio)));
  const spread = x.length === 0 ? null : Math.max(...x) - Math.min(...x);
  const wrongCount = bHatErrors.filter((error) => error > LARGE_ERROR).length;
  writeText(findElement("mean-x"), formatValue(mean(x)));
  writeText(findElement("mean-error"), formatValue(meanError));
  writeText(findElement("spread"), formatValue(spread));
  writeText(findElement("wrong"), bHatErrors.length === 0 ? "–" : `${wrongCount} of ${bHatErrors.length}`);
}

/** Shows the numbers of a robot in a state, or how to follow one if `robot` is null. */
export function showRobot(history, state, robot) {
  const [title, list] = findElement("robot").children;
  if (robot === null) {
    title.textContent =
      "Click a robot, or choose one by the arrow keys, to follow it and to read its numbers";
    list.replaceChildren();
    return;
  }
  const { robots, flawed, fill_ratio: fillRatio } = history.description;
  const flawedText = flawed.includes(robot) ? ", flawed at the start" : "";
  title.textContent = `Robot ${robots[robot]}${flawedText}`;
  const formatQuantity = (quantity) => formatValue(history.value(quantity, robot, state), 4);
  const rows = [
    ["trusts its sensor (b_hat)", formatQuantity("b_hat")],
    ["true accuracy (b)", formatQuantity("b")],
    ["sees by itself (x_hat)", formatQuantity("x_hat")],
    ["believes (x)", formatQuantity("x")],
    ["true share of black (f)", formatValue(fillRatio, 4)],
    ["hears", formatSenders(history, state, robot)],
  ];
  const cells = rows.flatMap(([name, text]) => [createElement("dt", name), createElement("dd", text)]);
  list.replaceChildren(...cells);
}

/** Returns the ids of the robots that a robot receives from in a state, or how many they are if too many. */
function formatSenders(history, state, robot) {
  const senderIds = history.links(state, robot).map(([sender]) => history.description.robots[sender]);
  if (senderIds.length > MAX_SHOWN_SENDERS) return `${senderIds.length} robots`;
  return senderIds.join(" ") || "–";
}

/** Returns two values as texts with two digits after the point, or with three if they would be equal. */
function formatChange(before, after) {
  const digits = before.toFixed(2) === after.toFixed(2) ? 3 : 2;
  return `${before.toFixed(digits)} → ${after.toFixed(digits)}`;
}

/** Returns an event as texts and elements; before a new b_hat stands the colour that the robot has from now on. */
function describeEvent(history, { robot, state, before, after, text }) {
  const prefix = robot === undefined ? "" : `robot ${history.description.robots[robot]}: `;
  if (text) return [prefix + text];
  const dot = createElement("i");
  dot.style.background = colourOfError(history.bHatError(robot, state));
  return [dot, prefix + formatChange(before, after)];
}

/** Lists the last events up to a tick, the latest first; `onSeek` is called with one that a user clicks. */
export function showEvents(history, tick, onSeek) {
  const { events } = history;
  const parent = findElement("events");
  const eventCount = events.findLastIndex((event) => event.tick <= tick) + 1;
  const key = String(eventCount);
  const isListed = parent.dataset.end === key;
  // What somebody is about to click must not move away.
  const isUnderMouse = parent.dataset.end !== "" && parent.matches(":hover");
  if (isListed || isUnderMouse) return;
  parent.dataset.end = key;
  const list = createElement("ol");
  const shownEvents = events.slice(Math.max(0, eventCount - MAX_SHOWN_EVENTS), eventCount);
  for (const event of shownEvents.reverse()) {
    const button = createElement("button");
    button.append(createElement("time", String(event.tick)), ...describeEvent(history, event));
    button.addEventListener("click", () => onSeek(event));
    const item = createElement("li");
    item.append(button);
    list.append(item);
  }
  const kinds = shownEvents.some(({ text }) => text)
    ? "Recalibrations (b_hat), faults"
    : "Recalibrations (b_hat)";
  const heading = eventCount === 0 ? "No recalibration yet" : `${kinds}: ${eventCount}`;
  parent.replaceChildren(createElement("h2", heading), list);
}
