// Time on the page: the tick that is shown, whether it moves and how fast, or follows a run as it goes.

const SECONDS_PER_RUN = 30;
const FOLLOWING_RATE = 6; // of the distance to the end, per second

export class Player {
  /** Creates a player that stands still at tick 0. */
  constructor() {
    this.tick = 0;
    this.end = 0;
    this.isPlaying = false;
    this.isFollowing = false;
    this.speed = 10;
  }

  /** The speeds that a user can choose, in steps per second. */
  static speeds = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000];

  /** Returns the speed at which a run of `steps` steps takes about half a minute. */
  static speedFor(steps) {
    const fittingSpeed = steps / SECONDS_PER_RUN;
    return Player.speeds.find((speed) => speed >= fittingSpeed) ?? Player.speeds.at(-1);
  }

  /** Moves the tick by what a number of seconds makes of it; at the end of the run the player pauses. */
  advance(seconds) {
    if (this.isFollowing) {
      // States come in blocks, so the tick closes the gap smoothly rather than jump to each new end.
      this.tick += (this.end - this.tick) * Math.min(1, FOLLOWING_RATE * seconds);
    } else if (this.isPlaying) {
      this.tick += seconds * this.speed;
      if (this.tick >= this.end) this.pause();
    }
    this.tick = Math.min(Math.max(this.tick, 0), this.end);
  }

  /** Plays from the present tick, or from the start if that is the end. */
  play() {
    if (this.tick >= this.end) this.tick = 0;
    this.isPlaying = true;
    this.isFollowing = false;
  }

  /** Stands still at the present tick. */
  pause() {
    this.isPlaying = false;
    this.isFollowing = false;
  }

  /** Whether the tick changes with time. */
  get isMoving() {
    return this.isPlaying || this.isFollowing;
  }

  /** Plays, or pauses if it plays or follows a run. */
  toggle() {
    if (this.isMoving) this.pause();
    else this.play();
  }

  /** Goes to a tick, as far as there is one; a player that played goes on from there. */
  seek(tick) {
    this.isFollowing = false;
    this.tick = Math.min(Math.max(tick, 0), this.end);
  }

  /** Stays at the end of a run that goes on. */
  follow() {
    this.isFollowing = true;
    this.isPlaying = false;
  }
}
