// Colours, read from the style sheet, which has those of light and dark pages in one place.

const MIDDLE_GREY = [169, 169, 169];
const LARGEST_ERROR = 0.4;
const COLOUR_STEPS = 64;

const colourCache = new Map();

/** Returns the colour that was computed for `key`, or computes it now. */
function cacheColour(key, compute) {
  if (!colourCache.has(key)) colourCache.set(key, compute());
  return colourCache.get(key);
}

/** Returns the colour that the style sheet calls `name`, as #rrggbb. */
export function colour(name) {
  return cacheColour(name, () => {
    // Browsers compute a variable's colour only for a property that uses it; this outline is never drawn.
    document.body.style.outlineColor = `var(--${name})`;
    const channels = getComputedStyle(document.body).outlineColor.match(/\d+/g);
    const digits = channels.map((channel) => Number(channel).toString(16).padStart(2, "0"));
    return `#${digits.join("")}`;
  });
}

/** Makes `colour` read the style sheet again, after a change between light and dark. */
export function clearColours() {
  colourCache.clear();
}

/** Returns the colour of a robot with this error |b_hat - b|: from blue over grey to orange, from 0.4 on. */
export function colourOfError(error) {
  if (Number.isNaN(error)) return colour("soft"); // unknown
  const step = Math.round(COLOUR_STEPS * Math.min(error / LARGEST_ERROR, 1));
  return cacheColour(`error ${step}`, () => colourOfShare(step / COLOUR_STEPS));
}

/** Returns the colour at a share, 0 to 1, of the scale from blue to orange. */
function colourOfShare(share) {
  if (share < 0.5) return mixColours(parseChannels(colour("right")), MIDDLE_GREY, 2 * share);
  return mixColours(MIDDLE_GREY, parseChannels(colour("wrong")), 2 * share - 1);
}

/** Returns the channels red, green and blue, 0 to 255, of a colour #rrggbb. */
function parseChannels(hexColour) {
  return [1, 3, 5].map((start) => Number.parseInt(hexColour.slice(start, start + 2), 16));
}

/** Returns the colour at a share of the line from one colour to another, which are given by channels. */
function mixColours(from, to, share) {
  const channels = from.map((value, index) => Math.round(value + share * (to[index] - value)));
  return `rgb(${channels.join(",")})`;
}
