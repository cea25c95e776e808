// What a run shows, in words that need no knowledge of the method.

/** Returns a share, 0 to 1, as text in percent, with at most `digits` digits after the point. */
export function formatPercent(share, digits = 1) {
  return `${+(100 * share).toFixed(digits)}\u00a0%`; // no line begins with the sign
}

/** Returns who of `total` robots misjudges its sensor at the start, as a sentence. */
function describeFlawed(count, total) {
  if (count === 0) return "All of them judge their sensor rightly (blue).";
  if (count === 1) return "One of them misjudges its sensor (orange).";
  if (count === total) return "All of them misjudge their sensor (orange).";
  const who = 2 * count === total ? "Half" : count;
  return `${who} of them misjudge their sensor (orange).`;
}

/** Returns what liars do, as a sentence; "" if there are none. */
function describeLiars(count) {
  if (count === 0) return "";
  if (count === 1) return "One claims that no tile is black.";
  return `${count} claim that no tile is black.`;
}

/** Returns how the run goes on, as a sentence. */
function describeOutcome(filter, flawedCount) {
  if (filter === "none") return "No filter corrects them.";
  return flawedCount > 0 ? "Watch them find out." : "Watch them agree.";
}

/**
 * Returns what a page shows, for somebody who has never heard of it.
 *
 * `description` is as view/history.py has it; "liars", the indices of robots that lie, may be missing. Without the
 * filter's name nothing is known of the robots but what they send.
 */
export function introduceRun({ robots, flawed, filter, liars = [] }) {
  const task = "Each robot guesses the share of black tiles";
  if (filter === null) return `${task} and sends its guess to the others.`;
  return [
    `${task}.`,
    describeFlawed(flawed.length, robots.length),
    describeLiars(liars.length),
    describeOutcome(filter, flawed.length),
  ]
    .filter(Boolean)
    .join(" ");
}

/** Returns what a page without any state waits for; a run without an end is that of a bus. */
export function describeWaiting({ steps }) {
  return steps === null ? "waiting for the bus: no robot has sent anything yet" : "waiting for the swarm";
}
