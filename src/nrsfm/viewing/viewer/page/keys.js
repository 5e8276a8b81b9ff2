// Keys. Each has one meaning; with Ctrl, Alt or the command key they are the browser's.

const element = (id) => document.getElementById(id);

export const KEYS = [
  [["space"], "play, pause"],
  [["←", "→"], "one frame; with shift ten"],
  [["Home", "End"], "first, last frame"],
  [["↑", "↓"], "faster, slower"],
  [["1", "…", "7"], "colour"],
  [["S", "P", "L"], "surface, points, lines"],
  [["F"], "object or camera stands still"],
  [["C"], "cameras"],
  [["I", "T"], "input, tracks"],
  [["O"], "parallel or central rays"],
  [["U"], "upside down"],
  [["+", "-"], "larger, smaller points"],
  [["R"], "view as at the beginning"],
  [["D"], "dark, light"],
  [["drag"], "turn; with shift, or the right button, move"],
  [["wheel"], "zoom; double click: view as at the beginning"],
];

export function listenToKeys(view) {
  const { controls, scene } = view;
  const look = view.stage.look;
  const step = (by) => (view.play(false), view.go(view.frame + by));
  const actions = {
    " ": () => view.play(),
    ArrowLeft: (shift) => step(shift ? -10 : -1),
    ArrowRight: (shift) => step(shift ? 10 : 1),
    Home: () => (view.play(false), view.go(0)),
    End: () => (view.play(false), view.go(scene.frames - 1)),
    ArrowUp: () => view.faster(1),
    ArrowDown: () => view.faster(-1),
    s: () => scene.triangles && controls.set({ shape: "surface" }),
    p: () => controls.set({ shape: "points" }),
    l: () => scene.lines && controls.set({ shape: "lines" }),
    f: () => controls.refer(look.reference === "camera" ? "object" : "camera"),
    c: () => controls.set({ cameras: !look.cameras }),
    i: () => controls.input(!controls.inputShown),
    t: () => controls.tracks(!view.picture.showTracks),
    o: () => controls.set({ parallel: !look.parallel }),
    u: () => controls.set({ over: !look.over }),
    r: () => (view.stage.reset(), view.change()),
    d: () => controls.theme(),
    "+": () => resize(1.15),
    "=": () => resize(1.15),
    "-": () => resize(1 / 1.15),
    "?": () => (element("help").open = !element("help").open),
  };
  const resize = (by) => {
    const size = Math.min(3, Math.max(0.3, look.size * by));
    element("size").value = size;
    controls.set({ size });
  };
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches("select")) return;
    const slider = event.target.matches("input[type=range]");
    if (slider && event.key.startsWith("Arrow")) return; // it moves the slider
    if (event.key === " " && event.target.matches("button, summary, input[type=checkbox]")) return; // it presses
    const colour = /^[1-9]$/.test(event.key) ? scene.colours[Number(event.key) - 1] : null;
    const action = colour ? () => controls.colour(colour.name) : actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action(event.shiftKey);
  });
}
