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
})();
