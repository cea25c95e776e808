// The table of the robots on a bus.

import assert from "node:assert/strict";
import { test } from "node:test";
import { Bus } from "view/bus";
import { element, FakeElement } from "./fake_page.js";

const ROW = {
  robot: 3,
  silent: false,
  seen: 0.25,
  health: "nominal",
  mode: "operational",
  rate: 9.96,
  loss: 0.004,
  conflicts: 0,
  x: 0.5,
  b_hat: 0.95,
  updates: 7,
  jumps: 0,
};

/** Returns the rows of the table of a report with these robots. */
function tableRowsOf(robots) {
  const roster = element("roster");
  roster.tBodies = [new FakeElement("tbody")];
  roster.caption = element("caption");
  element("filter").value = "";
  new Bus(() => {}).showReport({ robots, frames: [] });
  return roster.tBodies[0].children;
}

test("a row has what a robot has sent, and a dash for what is unknown", () => {
  const unknown = { health: null, mode: null, x: null, b_hat: null, updates: null };
  const rows = tableRowsOf([ROW, { ...ROW, robot: 8, ...unknown }]);
  assert.deepEqual(
    rows.map((row) => row.cells.map((cell) => cell.text)),
    [
      ["3", "0.3 s", "nominal", "operational", "10.0/s", "0.4 %", "0", "0.500", "0.950", "7", "0"],
      ["8", "0.3 s", "–", "–", "10.0/s", "0.4 %", "0", "–", "–", "–", "0"],
    ],
  );
});

test("what is alarming is marked, but for a robot that is silent", () => {
  const alarming = { health: "caution", mode: "maintenance", loss: 0.01, conflicts: 1 };
  const rows = tableRowsOf([
    ROW,
    { ...ROW, robot: 5, ...alarming },
    { ...ROW, robot: 8, ...alarming, silent: true },
  ]);
  const marked = rows.map((row) =>
    row.cells.flatMap((cell, column) => (cell.classes.has("alarm") ? [column] : [])),
  );
  assert.deepEqual(marked, [[], [2, 3, 5, 6], []]);
  assert.deepEqual(
    rows.map((row) => row.classes.has("silent")),
    [false, false, true],
  );
  assert.equal(element("caption").textContent, "3 robots, 1 silent");
});
