// A second view in 3D beside the first: one grasp alone, seen from the same side and at the same scale.

import { Mesh } from "../vendor/three/three.module.min.js";
import { darkMode } from "../dom.js";
import { drawnColour, frameAt, HandMesh, meshGeometry, meshMaterial } from "./meshes.js";
import { Renderer } from "./renderer.js";

export class PinnedView {
  /** @param canvas the canvas to draw on; @param view the view beside which it stands; @param grasp as the server tells it */
  constructor(canvas, view, grasp) {
    this.view = view;
    this.grasp = grasp;
    this.renderer = new Renderer(canvas);
    const { mesh, links } = view.description;
    this.body = new Mesh(meshGeometry(mesh), meshMaterial(view.colour("object")));
    this.hand = new HandMesh(links, view.colour("hand"));
    this.renderer.scene.add(this.body, this.hand);
    this.renderer.follow(view.renderer);
    view.renderer.onmoved = () => this.renderer.follow(view.renderer);
    this.renderer.onmoved = () => view.renderer.follow(this.renderer);
    darkMode.addEventListener("change", this.#recolour);
    this.place();
  }

  /** Place the hand as far closed as that of the other view, with frames where these are drawn. */
  place() {
    const { closed, showsFrames, description } = this.view, { frames, base, contacts } = this.grasp;
    this.hand.pose(frames, closed);
    this.renderer.frames.shown = showsFrames;
    this.renderer.frames.show(description, frameAt(frames[base], closed).transpose().toArray());
    this.renderer.contacts.show(closed === 1 ? contacts : []);
    this.renderer.invalidate();
  }

  /** Release everything. */
  stop() {
    this.view.renderer.onmoved = () => {};
    darkMode.removeEventListener("change", this.#recolour);
    this.body.geometry.dispose();
    this.body.material.dispose();
    this.hand.dispose();
    this.renderer.dispose();
  }

  #recolour = () => {
    this.body.material.uniforms.colour.value = drawnColour(this.view.colour("object"));
    this.hand.recolour(this.view.colour("hand"));
    this.renderer.invalidate();
  };
}
