// What of the sheet is seen: zoom, shift, search, and the way from the pointer to places on it.

import { app, block, set, shownBy, valueAt } from "./app.js";

export const camera = { x: 20, y: 10, k: 1, fitted: "" };
const world = () => document.querySelector(".world");
export const sheet = () => document.querySelector(".sheet");

export function look() {
  world()?.setAttribute("transform", `translate(${camera.x} ${camera.y}) scale(${camera.k})`);
}

export function fit() {
  const box = sheet()?.getBoundingClientRect();
  const view = app.state?.view;
  if (!box || !view) return;
  camera.k = Math.max(Math.min((box.width - 20) / view.width, (box.height - 20) / view.height, 1.6), 0.05);
  camera.x = (box.width - view.width * camera.k) / 2;
  camera.y = Math.max((box.height - view.height * camera.k) / 2, 0);
  look();
}

export function zoom(factor, x, y) {
  const box = sheet().getBoundingClientRect();
  const at = [x ?? box.width / 2, y ?? box.height / 2];
  const k = Math.min(Math.max(camera.k * factor, 0.05), 6);
  camera.x = at[0] - ((at[0] - camera.x) * k) / camera.k;
  camera.y = at[1] - ((at[1] - camera.y) * k) / camera.k;
  camera.k = k;
  look();
}

export function focusBlock(name) {
  document.querySelector(`[data-block="${CSS.escape(name)}"]`)?.focus({ preventScroll: true });
}

// Shifts the sheet where a block stands outside of what is seen.
export function bring(name) {
  const one = block(name);
  const box = sheet()?.getBoundingClientRect();
  if (!one || !box) return;
  const into = (start, size, room) => Math.max(Math.min(0, room - 10 - start - size), 10 - start);
  camera.x += into(camera.x + one.x * camera.k, one.width * camera.k, box.width);
  camera.y += into(camera.y + one.y * camera.k, one.height * camera.k, box.height);
  look();
}

shownBy((name) => {
  bring(name);
  focusBlock(name);
});

// The values of column and row under the pointer, null outside of the sheet.
export function cellAt(event) {
  const box = sheet()?.getBoundingClientRect();
  const [x, y] = [event.clientX - box?.left, event.clientY - box?.top];
  if (!(x >= 0 && y >= 0 && x <= box.width && y <= box.height)) return null;
  const { columns, rows } = app.state.view;
  const [u, v] = place(event);
  return [valueAt(columns, "left", "right", u), valueAt(rows, "top", "bottom", v)];
}

// Marks the blocks whose name or type holds a text, and brings the first to the middle.
export function find(text) {
  set({ search: text });
  const first = text && app.state.view?.blocks.find(found);
  if (!first) return;
  const box = sheet().getBoundingClientRect();
  camera.x = box.width / 2 - (first.x + first.width / 2) * camera.k;
  camera.y = box.height / 2 - (first.y + first.height / 2) * camera.k;
  look();
}

export const found = (one) => {
  const text = app.search.toLowerCase();
  return text && (one.name.toLowerCase().includes(text) || one.kind.toLowerCase().includes(text));
};

export function place(event) {
  const box = sheet().getBoundingClientRect();
  return [(event.clientX - box.left - camera.x) / camera.k, (event.clientY - box.top - camera.y) / camera.k];
}
