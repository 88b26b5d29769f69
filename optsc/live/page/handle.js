// Mouse handle: a ball at the tool; dragging it moves the hand in the plane of the screen, the wheel in its depth.

import * as THREE from "three";

const RADIUS = 0.024;
const REACH = 0.05; // how near to its middle a press counts [m]
const RING = 0.052;

export class Handle {
  constructor(view, hand) {
    this.view = view;
    this.hand = hand;
    this.group = new THREE.Group();
    this.ball = new THREE.Mesh(
      new THREE.SphereGeometry(RADIUS, 28, 20),
      new THREE.MeshStandardMaterial({ color: "#e8590c", roughness: 0.4, transparent: true, opacity: 0.92, depthTest: false }),
    );
    this.ring = new THREE.Mesh(
      new THREE.TorusGeometry(RING, 0.0022, 8, 48),
      new THREE.MeshBasicMaterial({ color: "#e8590c", transparent: true, opacity: 0.8, depthTest: false }),
    );
    this.ball.renderOrder = this.ring.renderOrder = 4;
    this.group.add(this.ball, this.ring);
    this.group.visible = false;
    view.world.add(this.group);
    const points = new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(new Float32Array(6), 3));
    this.line = new THREE.Line(points, new THREE.LineBasicMaterial({ color: "#e8590c" }));
    this.line.frustumCulled = false;
    view.world.add(this.line);
    this.ray = new THREE.Raycaster();
    this.plane = new THREE.Plane();
    this.pointer = null;
    const canvas = view.renderer.domElement;
    // Before the camera's own listeners, which have to leave a drag of the ball alone.
    canvas.addEventListener("pointerdown", (event) => this.down(event), { capture: true });
    canvas.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
      canvas.addEventListener(name, (event) => this.up(event));
    }
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false, capture: true });
  }

  aim(event) {
    const box = this.view.renderer.domElement.getBoundingClientRect();
    const at = new THREE.Vector2(
      (2 * (event.clientX - box.left)) / box.width - 1,
      1 - (2 * (event.clientY - box.top)) / box.height,
    );
    this.ray.setFromCamera(at, this.view.camera);
    return this.ray.ray;
  }

  near(event) {
    return this.group.visible && this.aim(event).distanceToPoint(this.group.position) < REACH;
  }

  down(event) {
    if (this.pointer !== null || event.button !== 0 || !this.near(event) || !this.hand.takeHold("mouse")) return;
    event.stopImmediatePropagation();
    this.pointer = event.pointerId;
    this.view.renderer.domElement.setPointerCapture(event.pointerId);
    this.face(this.hand.mapped());
    this.grip = this.hit(event).sub(this.hand.mapped());
    this.at = [event.clientX, event.clientY];
  }

  face(point) {
    const towards = this.view.camera.getWorldDirection(new THREE.Vector3());
    this.plane.setFromNormalAndCoplanarPoint(towards, point);
  }

  hit(event) {
    const ray = this.aim(event);
    return ray.intersectPlane(this.plane, new THREE.Vector3()) || this.hand.mapped();
  }

  move(event) {
    if (this.pointer === null) {
      this.view.renderer.domElement.style.cursor = this.near(event) ? "grab" : "";
      return;
    }
    if (event.pointerId !== this.pointer) return;
    const { goal, start, scale } = this.hand;
    if (event.shiftKey) {
      const about = new THREE.Vector3(event.clientY - this.at[1], event.clientX - this.at[0], 0).multiplyScalar(0.006);
      const angle = about.length();
      if (angle > 0) {
        about.applyQuaternion(this.view.camera.quaternion).normalize();
        goal.turn.premultiply(new THREE.Quaternion().setFromAxisAngle(about, angle));
      }
      this.grip = this.hit(event).sub(this.hand.mapped());
    } else {
      const tool = this.hit(event).sub(this.grip);
      goal.position.copy(tool.sub(start.tool).divideScalar(scale).add(start.hand));
    }
    this.at = [event.clientX, event.clientY];
  }

  wheel(event) {
    if (this.pointer === null) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    const towards = this.view.camera.getWorldDirection(new THREE.Vector3());
    const step = towards.multiplyScalar(-0.00025 * Math.max(-200, Math.min(200, event.deltaY)));
    this.hand.goal.position.addScaledVector(step, 1 / this.hand.scale);
    this.plane.translate(step);
  }

  up(event) {
    if (event.pointerId !== this.pointer) return;
    this.pointer = null;
    this.hand.letGo("mouse");
  }

  // Held by anything, the ball is where the hand leads to; else it is at the tool.
  show(moment) {
    const target = moment.of("target");
    this.group.visible = this.hand.drives;
    const at = this.hand.source === null ? new THREE.Vector3().fromArray(target) : this.hand.mapped();
    this.group.position.copy(at);
    this.ring.quaternion.copy(this.view.camera.quaternion);
    const held = this.hand.source !== null;
    this.ball.scale.setScalar(held ? 0.75 : 1);
    this.ring.material.opacity = held ? 1 : 0.55;
    const points = this.line.geometry.attributes.position;
    points.setXYZ(0, target[0], target[1], target[2]);
    points.setXYZ(1, at.x, at.y, at.z);
    points.needsUpdate = true;
    this.line.visible = held;
  }
}
