// SPDX-License-Identifier: Apache-2.0
// Shows the model in place of its picture once it is there, and turns it by the buttons.
(() => {
  const figure = document.querySelector("#model");
  const viewer = figure.querySelector("model-viewer");
  viewer.addEventListener("load", () => figure.classList.add("ready"));
  viewer.addEventListener("error", () => figure.classList.remove("ready"));
  for (const button of figure.querySelectorAll("button")) {
    button.addEventListener("click", () => {
      viewer.cameraTarget = "auto auto auto";
      viewer.fieldOfView = "auto";
      viewer.cameraOrbit = button.dataset.orbit;
    });
  }
  // Below a pale surface lie the parts of the simulated pile.
  const inside = figure.querySelector(".inside input");
  if (inside) inside.addEventListener("change", () => {
    for (const material of viewer.model.materials) {
      const surface = material.name === "surface", parts = material.name === "plausible parts";
      if (!surface && !parts) continue;
      const shown = inside.checked;
      material.setAlphaMode(surface ? (shown ? "BLEND" : "OPAQUE") : (shown ? "OPAQUE" : "MASK"));
      material.pbrMetallicRoughness.setBaseColorFactor(
        [1, 1, 1, surface ? (shown ? 0.2 : 1) : (shown ? 1 : 0)]);
    }
  });
})();
