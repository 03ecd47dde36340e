// What the page knows and does: the state of the file, the selection, edits with undo and redo, dialogs.

import { Live } from "./live.js";

export const app = {
  state: null, // of the file, as the server says
  sha: "", // of the file, as the server said last
  lost: 0, // code of a lost connection
  selected: null, // {block} or {wire: [source, target]}
  dialog: null, // {kind, ...}: palette, choose, rename, conflict, keys
  undo: [],
  redo: [],
  said: "",
  refused: [], // problems of the last edit that was refused
  search: "",
};

let draw = () => {};
export function drawnBy(function_) {
  draw = function_;
}
export function set(values) {
  Object.assign(app, values);
  draw();
}

let awaited = null; // tells the block that was added or renamed: the state comes behind the answer
let shown = () => {};
export function shownBy(function_) {
  shown = function_;
}

export let live = null;
export function start() {
  live = new Live(
    (state) => {
      const gone = app.selected?.block && !state.view?.blocks.some((one) => one.name === app.selected.block);
      set({ state, sha: state.sha, lost: 0, selected: gone ? null : app.selected });
      const fresh = awaited && state.view?.blocks.find(awaited);
      if (fresh) {
        awaited = null;
        select({ block: fresh.name });
        shown(fresh.name);
      }
    },
    (code) => set({ lost: code }),
  );
}

export const block = (name) => app.state?.view?.blocks.find((one) => one.name === name);
export const readOnly = () => app.state?.read_only || !app.state?.valid;

export const name_of = (operations) => {
  const first = operations[0];
  const words = {
    move: () => `move ${first.block}`,
    wire: () => `wire ${first.source} to ${first.target}`,
    cut: () => `cut ${first.source} to ${first.target}`,
    set: () => `set ${first.name}`,
    swap: () => `swap ${first.block}`,
    add: () => `add ${first.type}`,
    remove: () => `remove ${first.block}`,
    rename: () => `rename ${first.block}`,
    record: () => `record ${first.signal}`,
  };
  return words[first.op]?.() ?? "edit";
};

const DONE = { move: "moved", wire: "wired", swap: "swapped", add: "added", remove: "removed", rename: "renamed", record: "changed what is recorded:" };

// What is said of an edit that is done: "wired rotor.displacement to amb.displacement".
const saidOf = (title) => title.replace(/^\w+/, (word) => DONE[word] ?? word);

let last = Promise.resolve(); // edits go one after the other

const after = (work) => (last = last.then(work));

// Sends an edit; where: which list takes what undoes it. Returns whether it was written.
export const edit = (operations, more) => after(() => send(operations, more));

async function send(operations, { base, mine = false, title, where = "new" } = {}) {
  if (readOnly() || !operations.length) return false;
  awaited = null;
  const known = base ?? app.sha;
  const before = new Set(app.state.view.blocks.map((one) => one.name));
  const found = await live.ask({ kind: "edit", base: known, operations, mine });
  const words = title ?? name_of(operations);
  if (found.kind === "done") {
    const step = { back: found.undo, title: words };
    app.sha = found.sha;
    if (where === "undo") {
      app.redo.push(step);
    } else {
      app.undo.push(step);
      if (where === "new") app.redo.length = 0;
    }
    const said = { undo: `taken back: ${words}`, redo: `done again: ${words}` }[where] ?? saidOf(words);
    if (operations[0].op === "add") awaited = (one) => !before.has(one.name);
    if (operations[0].op === "rename") awaited = (one) => one.name === operations[0].to;
    set({ said, refused: [] });
    return true;
  }
  if (found.kind === "conflict") {
    set({ dialog: { kind: "conflict", found, operations, title: words, where } });
  } else if (found.kind === "refused") {
    set({ refused: found.problems, said: `not done: ${found.problems[0].what}` });
  } else {
    set({ said: `not done: ${words}; there is no connection to rotorsim serve` });
  }
  return false;
}

export const undo = () => after(() => back(app.undo, "undo"));
export const redo = () => after(() => back(app.redo, "redo"));

async function back(steps, where) {
  const step = steps.pop();
  if (step && !(await send(step.back, { title: step.title, where })) && app.dialog?.kind !== "conflict") steps.push(step);
  set({});
}

export function select(selected) {
  set({ selected, refused: [] });
}

export function remove() {
  if (app.selected?.wire) {
    const [source, target] = app.selected.wire;
    edit([{ op: "cut", source, target }]);
    select(null);
  } else if (app.selected?.block) {
    edit([{ op: "remove", block: app.selected.block }]);
  }
}

export function duplicate() {
  const one = block(app.selected?.block);
  if (!one?.editable) return;
  const written = Object.fromEntries(
    [...one.parameters, ...one.options].filter((item) => item.written !== null).map((item) => [item.name, item.written]),
  );
  const [column, row] = cell(one);
  edit([{ op: "add", type: one.type, at: [column, row + 0.5], parameters: written }]);
}

const COPIED = "rotorsim-block";

// Puts the selected block on the clipboard as JSON, so that another diagram, or an editor, can take it.
export function copy(event) {
  const one = block(app.selected?.block);
  if (!one || app.dialog || /^(INPUT|TEXTAREA)$/.test(document.activeElement.tagName)) return;
  const written = [...one.parameters, ...one.options].filter((item) => item.written !== null && item.written !== undefined);
  const parameters = Object.fromEntries(written.map((item) => [item.name, item.follows ? item.value : item.written]));
  event.clipboardData.setData("text/plain", JSON.stringify({ [COPIED]: one.name, type: one.type, parameters }));
  event.preventDefault();
  set({ said: `copied ${one.name}` });
}

export function paste(event) {
  if (readOnly() || app.dialog || /^(INPUT|TEXTAREA)$/.test(document.activeElement.tagName)) return;
  let given = null;
  try {
    given = JSON.parse(event.clipboardData.getData("text/plain"));
  } catch {
    return;
  }
  if (!given?.[COPIED] || typeof given.type !== "string") return;
  const rows = app.state.view.rows.map((each) => each.value);
  event.preventDefault();
  edit([{ op: "add", type: given.type, at: [0, (rows[rows.length - 1] ?? -1) + 1], parameters: given.parameters ?? {} }]);
}

// The values of column and row at which a block stands.
export function cell(one) {
  const view = app.state.view;
  const within = (cells, start, end, at) => cells.find((each) => at >= each[start] - 1 && at <= each[end] + 1);
  const column = within(view.columns, "left", "right", one.x + one.width / 2);
  const row = within(view.rows, "top", "bottom", one.y + one.height / 2);
  return [column?.value ?? 0, row?.value ?? 0];
}

// The value for a place [px]: that of the column or row there, or one between two of them.
export function valueAt(cells, start, end, at) {
  if (!cells.length) return 0;
  if (at < cells[0][start]) return cells[0].value - 1;
  for (let k = 0; k < cells.length; k++) {
    if (at <= cells[k][end]) {
      return at >= cells[k][start] ? cells[k].value : (cells[k - 1].value + cells[k].value) / 2;
    }
  }
  return cells[cells.length - 1].value + 1;
}

// The cell that a block may have; where another stands there, in a row of its own below that.
export function free(name, column, row) {
  const taken = app.state.view.blocks.some((one) => {
    const [c, r] = cell(one);
    return one.name !== name && c === column && r === row;
  });
  const rows = app.state.view.rows.map((one) => one.value);
  const next = rows.find((value) => value > row);
  return [column, taken ? (next === undefined ? row + 1 : (row + next) / 2) : row];
}

export const move = (name, column, row) => edit([{ op: "move", block: name, to: free(name, column, row) }]);
