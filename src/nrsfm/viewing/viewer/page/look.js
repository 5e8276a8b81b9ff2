// What the viewer and the player of reports say and show alike: the speeds, the legend of a scale, the picture's colours.

export const SPEEDS = [0.1, 0.25, 0.5, 1, 1.5, 2, 4];
const short = (value) => Number(value.toPrecision(2)).toString().replace("-", "−");

// Name, gradient, three ticks and a note of a way to colour; null where it has no scale.
export function legendOf(scene, colour) {
  if (colour.kind !== "scale" && colour.kind !== "depth") return null;
  const [low, high] = colour.kind === "depth" ? scene.depth : [colour.low, colour.high];
  const map = scene.maps[colour.map];
  const stops = Array.from({ length: 17 }, (_, k) => map.slice(3 * Math.round((k * 254) / 16)).slice(0, 3));
  const ticks = [low, (low + high) / 2, high].map(short);
  if (colour.kind === "depth") [ticks[0], ticks[2]] = [`near ${ticks[0]}`, `${ticks[2]} far`];
  else if (colour.name !== "confidence") ticks[2] = `≥ ${ticks[2]}`;
  return {
    name: colour.label + (colour.has_unit && scene.unit ? ` (${scene.unit})` : ""),
    background: `linear-gradient(to right, ${stops.map((c) => `rgb(${c})`).join(", ")})`,
    ticks,
    note: colour.unknown ? "grey: not known" : "",
  };
}

// Colours of the 3D picture on the background of an element, for a dark or a light page.
export function themeOf(element, plain, dark) {
  const rgb = (text) => text.match(/[\d.]+/g).slice(0, 3).map((value) => Number(value) / 255);
  const own = plain.match(/\w\w/g).map((pair) => parseInt(pair, 16) / 255);
  const style = getComputedStyle(element);
  return {
    paper: rgb(style.backgroundColor),
    ink: rgb(style.color),
    accent: dark ? [0.5, 0.7, 0.88] : [0.18, 0.43, 0.66],
    grey: dark ? [0.36, 0.38, 0.41] : [0.74, 0.73, 0.71],
    plain: dark ? own : own.map((value) => 0.97 * value),
  };
}
