// Mouse, pen and fingers on the 3D picture: turn, move, zoom. In a page that scrolls, the wheel may belong to the page:
// ``takesWheel`` says, of an event, whether it zooms.

export function listenToPointers(view, takesWheel = () => true) {
  const { stage } = view;
  const { canvas } = stage;
  const down = new Map();
  const zoom = (by) => (stage.zoom = Math.min(40, Math.max(0.15, stage.zoom * by)));
  const move = (dx, dy) => {
    stage.pan[0] += dx * stage.perPixel;
    stage.pan[1] -= dy * stage.perPixel;
  };
  const turn = (dx, dy) => {
    stage.yaw += dx * 0.008;
    stage.pitch = Math.min(1.55, Math.max(-1.55, stage.pitch + dy * 0.008));
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    down.set(event.pointerId, [event.clientX, event.clientY]);
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = down.get(event.pointerId);
    if (!before) return;
    const [dx, dy] = [event.clientX - before[0], event.clientY - before[1]];
    if (down.size === 2) {
      const other = [...down].find(([id]) => id !== event.pointerId)[1];
      const apart = (at) => Math.hypot(at[0] - other[0], at[1] - other[1]) || 1;
      zoom(apart([event.clientX, event.clientY]) / apart(before));
      move(dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons & 6) move(dx, dy);
    else turn(dx, dy);
    down.set(event.pointerId, [event.clientX, event.clientY]);
    view.change();
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => down.delete(event.pointerId));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", () => (stage.reset(), view.change()));
  canvas.addEventListener("wheel", (event) => {
    if (!takesWheel(event)) return;
    event.preventDefault();
    zoom(Math.exp(-0.0012 * event.deltaY * (event.deltaMode ? 30 : 1)));
    view.change();
  }, { passive: false });
}
