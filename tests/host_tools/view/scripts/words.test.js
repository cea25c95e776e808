// What the pages say in words.

import assert from "node:assert/strict";
import { test } from "node:test";
import { describeWaiting, formatPercent, introduceRun } from "view/words";

/** Returns the introduction of a run of 20 robots. */
function introduce({ flawed = 0, liars = 0, filter = "robust" }) {
  const firstRobots = (count) => Array.from({ length: count }, (_, robot) => robot);
  return introduceRun({
    robots: firstRobots(20),
    flawed: firstRobots(flawed),
    liars: firstRobots(liars),
    filter,
  });
}

test("the introduction has how many robots misjudge their sensors", () => {
  const sentences = [0, 1, 6, 10, 20].map((flawed) => introduce({ flawed }).split(". ")[1]);
  assert.deepEqual(sentences, [
    "All of them judge their sensor rightly (blue)",
    "One of them misjudges its sensor (orange)",
    "6 of them misjudge their sensor (orange)",
    "Half of them misjudge their sensor (orange)",
    "All of them misjudge their sensor (orange)",
  ]);
});

test("the introduction ends with what becomes of the robots", () => {
  const settings = [{ flawed: 10 }, { flawed: 0 }, { flawed: 10, filter: "none" }];
  const endings = settings.map((each) => introduce(each).split(". ").at(-1));
  assert.deepEqual(endings, ["Watch them find out.", "Watch them agree.", "No filter corrects them."]);
});

test("the introduction has liars, if there are any", () => {
  const counts = [0, 1, 2].map(
    (liars) => introduce({ flawed: 10, liars }).match(/\S+ claims? .*black\./)?.[0],
  );
  assert.deepEqual(counts, [
    undefined,
    "One claims that no tile is black.",
    "2 claim that no tile is black.",
  ]);
});

test("of robots elsewhere the introduction has what is known", () => {
  const introduction = introduceRun({ robots: [], flawed: [], filter: null });
  assert.equal(
    introduction,
    "Each robot guesses the share of black tiles and sends its guess to the others.",
  );
});

test("a share is a percentage with a digit after the point if it needs one", () => {
  assert.deepEqual(
    [0.55, 0.125, 0, 1].map((share) => formatPercent(share)),
    ["55\u00a0%", "12.5\u00a0%", "0\u00a0%", "100\u00a0%"],
  );
  assert.equal(formatPercent(0.556, 0), "56\u00a0%");
});

test("a page without data waits for the bus or for the swarm", () => {
  const texts = [null, 300].map((steps) => describeWaiting({ steps }));
  assert.deepEqual(texts, ["waiting for the bus: no robot has sent anything yet", "waiting for the swarm"]);
});
