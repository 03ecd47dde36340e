// What is done with the selected blocks: choose more, remove, duplicate, copy and paste, group.

import { app, block, cell, chosen, edit, readOnly, select, set } from "./app.js";

export const isChosen = (name) => chosen().includes(name);

// Adds a block to those that are selected, or takes it from them.
export function toggle(name) {
  const [first, ...others] = isChosen(name) ? chosen().filter((one) => one !== name) : [name, ...chosen()];
  select(first ? { block: first, others } : null);
}

export function selectAll(names) {
  const [first, ...others] = names;
  select(first ? { block: first, others } : null);
}

export const editable = () => chosen().map(block).filter((one) => one?.editable);

export function remove() {
  if (app.selected?.wire) {
    const [source, target] = app.selected.wire;
    edit([{ op: "cut", source, target }]);
    select(null);
  } else if (editable().length) {
    edit(editable().map((one) => ({ op: "remove", block: one.name })));
  }
}

// Blocks as they are written in the file, with the wires among them and their cells.
function fragment(blocks) {
  const names = new Set(blocks.map((one) => one.name));
  const owner = (end) => end.split(".")[0];
  const wires = app.state.view.wires.filter((wire) => names.has(owner(wire.source)) && names.has(owner(wire.target)));
  return {
    blocks: Object.fromEntries(blocks.map((one) => [one.name, one.entry])),
    wires: wires.map((wire) => [wire.source, wire.target]),
    at: Object.fromEntries(blocks.map((one) => [one.name, cell(one)])),
  };
}

// Cells shifted so that the first row is another.
function shifted(at, row) {
  const first = Math.min(...Object.values(at).map((one) => one[1]));
  return Object.fromEntries(Object.entries(at).map(([name, [c, r]]) => [name, [c, r - first + row]]));
}

export function duplicate() {
  const blocks = editable();
  if (!blocks.length) return;
  const given = fragment(blocks);
  const rows = Object.values(given.at).map((one) => one[1]);
  edit([{ op: "insert", ...given, at: shifted(given.at, blocks.length > 1 ? Math.max(...rows) + 0.5 : rows[0] + 0.5) }]);
}

// The value that a followed parameter of the diagram has, as it is written there.
const written = (item) => app.state.view.parameters.find((one) => one.name === item.follows)?.written ?? item.value;

const COPIED = "rotorsim-blocks";
const elsewhere = () => app.dialog || /^(INPUT|TEXTAREA)$/.test(document.activeElement.tagName);

// Puts the selected blocks on the clipboard as JSON, so that another diagram, or an editor, can take them.
export function copy(event) {
  const blocks = editable();
  if (!blocks.length || elsewhere() || String(getSelection())) return; // text that is marked is copied as ever
  const given = { ...fragment(blocks), folder: app.state.folder };
  for (const one of blocks) {
    const followed = one.parameters.filter((item) => item.follows && one.entry.parameters?.[item.name]);
    const values = Object.fromEntries(followed.map((item) => [item.name, written(item)]));
    if (followed.length) given.blocks[one.name] = { ...one.entry, parameters: { ...one.entry.parameters, ...values } };
  }
  event.clipboardData.setData("text/plain", JSON.stringify({ [COPIED]: given }));
  event.preventDefault();
  set({ said: `copied ${blocks.map((one) => one.name).join(", ")}` });
}

export function paste(event) {
  if (readOnly() || elsewhere()) return;
  let given = null;
  try {
    given = JSON.parse(event.clipboardData.getData("text/plain"))?.[COPIED];
  } catch {
    return;
  }
  if (typeof given?.blocks !== "object" || !given.at) return;
  const { folder, ...copied } = given;
  event.preventDefault();
  if (folder !== app.state.folder && Object.values(copied.blocks).some((one) => one?.file)) {
    return set({ said: "not pasted: a sub-diagram or FMU among these blocks has its file in another folder" });
  }
  const rows = app.state.view.rows.map((each) => each.value);
  edit([{ op: "insert", ...copied, at: shifted(given.at, (rows[rows.length - 1] ?? -1) + 1) }]);
}

export const group = () => editable().length && set({ dialog: { kind: "group", blocks: editable().map((one) => one.name) } });
export const dissolve = (name) => edit([{ op: "dissolve", block: name }]);
