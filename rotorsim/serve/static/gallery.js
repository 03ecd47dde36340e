// The diagrams that come with rotorsim, each to be copied to the folder of the user.

import { html, useEffect, useState } from "./vendor/htm-preact-3.1.1.module.js";
import { get, post } from "./live.js";

// The first sentence; the whole text is shown at the pointer.
const first = (text) => (text.length > 150 ? text.split(/[.;:] /)[0].slice(0, 220) + " ..." : text);

export function Gallery() {
  const [diagrams, show] = useState([]);
  const [said, say] = useState("");
  useEffect(() => {
    get("/api/gallery").then(async (answer) => show((await answer.json()).diagrams), (error) => say(error.message));
  }, []);
  const copy = async (name) => {
    const found = await post("/api/copy", { name });
    if (found.problems) say(found.problems[0].what);
  };
  return html`<main class="gallery"><h1>Diagrams that come with rotorsim</h1>
    <p role="alert">${said}</p>
    <ul>${diagrams.map(
      (one) => html`<li key=${one.name}><h2>${one.name}</h2><p title=${one.description}>${first(one.description)}</p>
        <button data-testid=${`gallery-${one.name}`} onClick=${() => copy(one.name)}>Copy to my folder</button></li>`,
    )}</ul></main>`;
}
