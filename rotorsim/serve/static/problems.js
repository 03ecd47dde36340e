// What is wrong with the diagram, and with the last edit; a click goes to the block.

import { html } from "./vendor/htm-preact-3.1.1.module.js";
import { app, select } from "./app.js";
import { bring } from "./camera.js";

export function Problems() {
  const listed = [...app.refused.map((one) => ({ ...one, refused: true })), ...(app.state.problems ?? [])];
  if (!listed.length) return null;
  return html`<ul class="problems" data-testid="problems" aria-label="Problems">
    ${listed.map(
      (one, k) => html`<li key=${k} class=${one.severity}>
        <button data-testid="problem" disabled=${!one.block} onClick=${() => (select({ block: one.block }), bring(one.block))}>
          <span class="mark" role="img" aria-label=${one.severity}>${one.severity === "error" ? "!" : "?"}</span>
          ${one.refused ? "not done: " : ""}${one.place && html`<span class="place">${one.place} </span>`}
          <b>${one.subject}</b> ${one.what}${one.hint && html` <span class="hint">${one.hint}</span>`}
        </button></li>`,
    )}
  </ul>`;
}
