// The colour of a robot, by how wrong it is about its sensor.

import assert from "node:assert/strict";
import { test } from "node:test";
import "./fake_page.js"; // whose style sheet has right, wrong and soft
import { colour, colourOfError } from "view/colours";

test("a colour of the style sheet is written in hexadecimal digits", () => {
  assert.equal(colour("wrong"), "#ff6400");
});

test("from no error to 0.4 the colour goes from blue over grey to orange", () => {
  const colours = [0, 0.1, 0.2, 0.3, 0.4].map(colourOfError);
  assert.deepEqual(colours, [
    "rgb(0,0,255)",
    "rgb(85,85,212)",
    "rgb(169,169,169)",
    "rgb(212,135,85)",
    "rgb(255,100,0)",
  ]);
});

test("larger errors have the colour of 0.4", () => {
  assert.equal(colourOfError(1), colourOfError(0.4));
});

test("an unknown error has a colour of its own", () => {
  assert.equal(colourOfError(Number.NaN), "#010203");
});
