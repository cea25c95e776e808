// The tick that is shown: played at a speed, followed, or chosen.

import assert from "node:assert/strict";
import { test } from "node:test";
import { Player } from "view/player";

/** Returns a player of a run of 100 steps, at a tick. */
function playerAt(tick) {
  const player = new Player();
  player.end = 100;
  player.seek(tick);
  return player;
}

test("a run takes half a minute or a little less", () => {
  const speeds = [30, 300, 301, 10000, 1e9].map((steps) => Player.speedFor(steps));
  assert.deepEqual(speeds, [1, 10, 20, 500, 5000]);
});

test("a player that plays goes on by its speed", () => {
  const player = playerAt(20);
  player.play();
  player.speed = 50;
  player.advance(0.5);
  assert.equal(player.tick, 45);
});

test("a player stops at the end, and plays from the start again", () => {
  const player = playerAt(99);
  player.play();
  player.advance(60);
  assert.deepEqual([player.tick, player.isPlaying], [100, false]);
  player.play();
  assert.deepEqual([player.tick, player.isPlaying], [0, true]);
});

test("a player that follows closes the gap to the end", () => {
  const player = playerAt(0);
  player.follow();
  player.advance(0.125);
  assert.equal(player.tick, 75);
  player.advance(1);
  assert.equal(player.tick, 100);
});

test("a tick that does not exist leads to the nearest end", () => {
  assert.deepEqual([playerAt(-5).tick, playerAt(500).tick], [0, 100]);
});

test("the button pauses a player that follows", () => {
  const player = playerAt(20);
  player.follow();
  player.toggle();
  assert.deepEqual([player.isMoving, player.tick], [false, 20]);
});
