// The keyboard: what every key does.

import { app, block, cell, chosen, enter, move, moveBy, readOnly, redo, select, set, undo } from "./app.js";
import { run } from "./runs.js";
import { bring, fit, focusBlock } from "./camera.js";
import { dissolve, duplicate, editable, group, remove, selectAll, toggle } from "./selection.js";

export const KEYS = [
  ["Tab", "next block"],
  ["Arrows", "nearest block in that direction"],
  ["Shift + arrows", "select the block there, too (Shift + click, Shift + drag)"],
  ["Ctrl+A", "select all blocks"],
  ["Alt + arrows", "move by a column or row"],
  ["Enter", "to its values"],
  ["w", "wire one of its ports"],
  ["a", "add a block"],
  ["o", "open a sub-diagram, or close the one that a block is in"],
  ["e, b", "enter the file of a sub-diagram; back to the diagram that it is in"],
  ["g, x", "group the selected blocks into a sub-diagram; dissolve it"],
  ["d", "duplicate"],
  ["Ctrl+C, Ctrl+V", "copy the blocks; paste them, into another diagram too"],
  ["r", "rename"],
  ["s", "swap for another type"],
  ["Delete", "remove the blocks, or cut the wire"],
  ["u, Ctrl+Z", "undo"],
  ["Ctrl+Y, Ctrl+Shift+Z", "redo"],
  ["p", "run"],
  ["f", "the whole diagram"],
  ["/", "find a block"],
  ["Escape", "close, or select nothing"],
];
const STEPS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

export function onKey(event) {
  if (!app.state?.view || app.dialog) return;
  const typing = /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName) && !/^(range|checkbox)$/.test(event.target.type);
  const control = event.ctrlKey || event.metaKey;
  if (control && event.key.toLowerCase() === "z" && !typing) return act(event, event.shiftKey ? redo : undo);
  if (control && event.key.toLowerCase() === "y" && !typing) return act(event, redo);
  if (control && event.key.toLowerCase() === "a" && !typing) return act(event, () => selectAll(app.state.view.blocks.filter((one) => one.editable).map((one) => one.name)));
  if (event.key === "Escape") return act(event, () => (typing ? event.target.blur() : select(null)));
  if (typing || control) return;
  const one = block(app.selected?.block);
  if (STEPS[event.key] && one && event.target.type !== "range") return act(event, () => (event.altKey ? shift(one, STEPS[event.key]) : go(one, STEPS[event.key], event.shiftKey)));
  const actions = {
    p: () => run(),
    f: fit,
    "/": () => document.querySelector("[data-testid=search]").focus(),
    "?": () => set({ dialog: { kind: "keys" } }),
  };
  if (app.state.part) actions.b = () => enter(app.state.part.split("/").slice(0, -1).join("/"));
  if (one?.closed || one?.part) actions.o = () => document.querySelector("[data-testid=open-part], [data-testid=close-part]")?.click();
  if (one?.closed || one?.part) actions.e = () => document.querySelector("[data-testid=enter-part]")?.click();
  if (one) actions.Enter = () => document.querySelector("aside input, aside select, aside button")?.focus();
  if (!readOnly()) {
    actions.a = () => set({ dialog: { kind: "palette" } });
    actions.u = undo;
    actions.Delete = actions.Backspace = () => app.selected && remove();
  }
  if (editable().length && !readOnly()) {
    actions.d = duplicate;
    actions.g = group;
  }
  if (one?.editable && !readOnly()) {
    if (one.closed) actions.x = () => dissolve(one.name);
    actions.r = () => set({ dialog: { kind: "rename", block: one.name } });
    actions.s = () => set({ dialog: { kind: "swap", block: one.name } });
    actions.w = () => set({ dialog: { kind: "wire", block: one.name } });
  }
  const action = actions[event.key];
  if (action && (event.key !== "Enter" || event.target.closest?.(".block") || event.target === document.body)) act(event, action);
}

function act(event, action) {
  event.preventDefault();
  action();
}

function shift(one, [dx, dy]) {
  if (!one.editable) return;
  const view = app.state.view;
  const next = (cells, value, step) => {
    const values = cells.map((each) => each.value);
    const k = values.indexOf(value) + step;
    return values[k] ?? value + step;
  };
  const [column, row] = cell(one);
  if (chosen().length > 1) {
    const names = editable().map((each) => each.name);
    return moveBy(names, dx ? next(view.columns, column, dx) - column : 0, dy ? next(view.rows, row, dy) - row : 0);
  }
  move(one.name, dx ? next(view.columns, column, dx) : column, dy ? next(view.rows, row, dy) : row);
}

// Selects the block that is nearest in a direction; more: beside those that are.
function go(one, [dx, dy], more) {
  const middle = (each) => [each.x + each.width / 2, each.y + each.height / 2];
  const [x, y] = middle(one);
  const far = (each) => {
    const [u, v] = middle(each);
    const along = (u - x) * dx + (v - y) * dy;
    return along <= 1 ? Infinity : along + 2 * Math.abs((u - x) * dy + (v - y) * dx);
  };
  const best = app.state.view.blocks.reduce((a, b) => (far(b) < far(a) ? b : a));
  if (far(best) < Infinity) {
    if (!more) select({ block: best.name });
    else if (!chosen().includes(best.name)) toggle(best.name);
    else select({ block: best.name, others: chosen().filter((name) => name !== best.name) });
    focusBlock(best.name);
    bring(best.name);
  }
}
