// Colours, read from the style, where those of a light and a dark system are in one place.

const cache = new Map();

function cached(key, make) {
  if (!cache.has(key)) cache.set(key, make());
  return cache.get(key);
}

/** A colour of the style by its name, as #rrggbb. */
export function colour(name) {
  return cached(name, () => {
    document.body.style.outlineColor = `var(--${name})`; // of no outline: it is there to be computed
    const found = getComputedStyle(document.body).outlineColor.match(/\d+/g);
    return `#${found.map((each) => Number(each).toString(16).padStart(2, "0")).join("")}`;
  });
}

/** Reads all colours again, after a change between light and dark. */
export function forgetColours() {
  cache.clear();
}

function channels(hex) {
  return [1, 3, 5].map((at) => Number.parseInt(hex.slice(at, at + 2), 16));
}

const MIDDLE = [169, 169, 169];
const MOST = 0.4;

/** Colour of a robot that is wrong by |b_hat - b|: blue, over grey, to orange from 0.4 on. */
export function colourOfError(error) {
  if (Number.isNaN(error)) return colour("soft"); // unknown
  const step = Math.round(64 * Math.min(error / MOST, 1));
  return cached(`error ${step}`, () => {
    const share = step / 64;
    const [from, to] =
      share < 0.5 ? [channels(colour("right")), MIDDLE] : [MIDDLE, channels(colour("wrong"))];
    const way = share < 0.5 ? 2 * share : 2 * share - 1;
    return `rgb(${from.map((each, i) => Math.round(each + way * (to[i] - each))).join(",")})`;
  });
}
