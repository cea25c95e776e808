// Time: which tick is shown, whether it runs, how fast, and whether it follows a run as it goes.

const SECONDS_OF_A_FILM = 30;

export class Player {
  constructor() {
    this.tick = 0;
    this.end = 0;
    this.isPlaying = false;
    this.isFollowing = false;
    this.speed = 10;
  }

  /** Speeds to choose from, in steps per second. */
  static speeds = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000];

  /** The speed at which a film of so many steps takes about half a minute. */
  static speedFor(steps) {
    const wanted = steps / SECONDS_OF_A_FILM;
    return Player.speeds.find((speed) => speed >= wanted) ?? Player.speeds.at(-1);
  }

  /** Lets time pass. */
  advance(seconds) {
    if (this.isFollowing) {
      // The gap closes smoothly, since samples come in blocks.
      this.tick += (this.end - this.tick) * Math.min(1, 6 * seconds);
    } else if (this.isPlaying) {
      this.tick += seconds * this.speed;
      if (this.tick >= this.end) this.pause();
    }
    this.tick = Math.min(Math.max(this.tick, 0), this.end);
  }

  play() {
    if (this.tick >= this.end) this.tick = 0;
    this.isPlaying = true;
    this.isFollowing = false;
  }

  toggle() {
    if (this.isPlaying) this.pause();
    else this.play();
  }

  pause() {
    this.isPlaying = this.isFollowing = false;
  }

  seek(tick) {
    this.isFollowing = false;
    this.tick = Math.min(Math.max(tick, 0), this.end);
  }

  follow() {
    this.isFollowing = true;
    this.isPlaying = false;
  }
}
