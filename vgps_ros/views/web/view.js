// Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
// The view of the page: three.js draws MuJoCo's geometries where MuJoCo has them, and a hand pulls at
// them.

function shape(three, model, i, kinds) {
  const [a, b, c] = model.geom_size.subarray(3 * i, 3 * i + 3), quarter = Math.PI / 2;
  switch (model.geom_type[i]) {
    case kinds.mjGEOM_SPHERE.value: return new three.SphereGeometry(a, 32, 20);
    case kinds.mjGEOM_CAPSULE.value: return new three.CapsuleGeometry(a, 2 * b, 12, 28).rotateX(quarter);
    case kinds.mjGEOM_CYLINDER.value: return new three.CylinderGeometry(a, a, 2 * b, 40).rotateX(quarter);
    case kinds.mjGEOM_ELLIPSOID.value: return new three.SphereGeometry(1, 32, 20).scale(a, b, c);
    case kinds.mjGEOM_BOX.value: return new three.BoxGeometry(2 * a, 2 * b, 2 * c);
    case kinds.mjGEOM_MESH.value: case kinds.mjGEOM_SDF.value: {
      const mesh = model.geom_dataid[i], geometry = new three.BufferGeometry();
      const [v, f] = [model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]];
      const points = model.mesh_vert.slice(3 * v, 3 * (v + model.mesh_vertnum[mesh]));
      geometry.setAttribute("position", new three.BufferAttribute(points, 3));
      geometry.setIndex([...model.mesh_face.subarray(3 * f, 3 * (f + model.mesh_facenum[mesh]))]);
      return normals(geometry.toNonIndexed());
    }
    case kinds.mjGEOM_HFIELD.value: {
      const field = model.geom_dataid[i], [x, y, z] = model.hfield_size.subarray(4 * field);
      const [rows, columns] = [model.hfield_nrow[field], model.hfield_ncol[field]];
      const geometry = new three.PlaneGeometry(2 * x, 2 * y, columns - 1, rows - 1);
      const heights = model.hfield_data.subarray(model.hfield_adr[field]);
      for (let row = 0; row < rows; row++)  // the first row of three.js is the last of MuJoCo
        for (let column = 0; column < columns; column++)
          geometry.attributes.position.setZ((rows - 1 - row) * columns + column,
                                            z * heights[row * columns + column]);
      return normals(geometry);
    }
  }
  return null;
}
const normals = geometry => { geometry.computeVertexNormals(); return geometry; };

class View {
  constructor(three, OrbitControls, robot) {
    const {mujoco, model, data, about} = robot, dark = matchMedia("(prefers-color-scheme: dark)");
    Object.assign(this, {three, robot});
    this.renderer = new three.WebGLRenderer({canvas: $("view"), antialias: true});
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.shadowMap.enabled = true;
    this.scene = new three.Scene();
    this.ambient = new three.HemisphereLight(0xffffff, 0xa0a8b4, 2.1);
    this.sun = new three.DirectionalLight(0xfff4e6, 1.9);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(1024, 1024);
    this.sun.shadow.bias = -0.0005;
    this.scene.add(this.ambient, this.sun, this.sun.target);
    // The geometries that MuJoCo's own viewer shows, or all of them where it shows none.
    const kinds = mujoco.mjtGeom, all = Array.from({length: model.ngeom}, (_, i) => i);
    const moving = i => model.body_weldid[model.geom_bodyid[i]] > 0;
    const shown = all.filter(i => model.geom_group[i] < 3);
    this.parts = [];
    for (const i of shown.some(moving) ? shown : all) {
      const material = model.geom_matid[i], geometry = shape(three, model, i, kinds);
      const [r, g, b, alpha] = material < 0 ? model.geom_rgba.subarray(4 * i)
                                            : model.mat_rgba.subarray(4 * material);
      if (!geometry || !alpha) continue;
      const part = new three.Mesh(geometry, new three.MeshStandardMaterial(
        {roughness: 0.55, metalness: 0.05, opacity: alpha, transparent: alpha < 1}));
      part.material.color.setRGB(r, g, b, three.SRGBColorSpace);
      part.castShadow = part.receiveShadow = true;
      part.matrixAutoUpdate = false;
      part.userData = {geom: i, body: model.geom_bodyid[i]};
      this.parts.push(part);
      this.scene.add(part);
    }
    this.place();
    const box = new three.Box3(), robots = this.parts.filter(p => moving(p.userData.geom));
    for (const part of robots) box.expandByObject(part);
    const ball = box.getBoundingSphere(new three.Sphere());
    this.size = Math.max(ball.radius, 0.05);
    this.offset = ball.center.clone().sub(this.base());
    this.ground(all.find(i => model.geom_type[i] === kinds.mjGEOM_PLANE.value), box.min.z);
    const away = about.above ? [0, -0.6, 3.6] : [-1.5, -2.6, 1.1];
    this.camera = new three.PerspectiveCamera(38, 1, this.size / 50, this.size * 200);
    this.camera.up.set(0, 0, 1);
    this.camera.position.set(...away).multiplyScalar(this.size * 1.15).add(ball.center);
    this.orbit = new OrbitControls(this.camera, $("view"));
    this.orbit.enablePan = false;
    this.orbit.enableDamping = true;
    this.orbit.maxPolarAngle = Math.PI / 2 - 0.03;
    [this.orbit.minDistance, this.orbit.maxDistance] = [1.2 * this.size, 30 * this.size];
    this.orbit.target.copy(ball.center);
    const reach = 2.2 * this.size, shadow = this.sun.shadow.camera;
    Object.assign(shadow, {left: -reach, right: reach, top: reach, bottom: -reach, far: 12 * reach});
    this.arrow = new three.ArrowHelper(new three.Vector3(0, 0, 1), undefined, 1, 0xe0503a);
    this.arrow.visible = false;
    this.scene.add(this.arrow);
    this.ray = new three.Raycaster();
    const paint = () => {
      const sky = getComputedStyle(document.documentElement).getPropertyValue("--sky");
      this.scene.background = new three.Color(sky);
      this.scene.fog = new three.Fog(sky, 9 * this.size, 34 * this.size);
      this.floor.material.map = this.tile(dark.matches);
    };
    dark.addEventListener("change", paint);
    paint();
    new ResizeObserver(() => this.resize()).observe($("view"));
    this.resize();
  }

  resize() {
    const {clientWidth: width, clientHeight: height} = $("view");
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.zoom = Math.min(1, width / height * 0.9);  // on a phone the robot fits the width
    this.camera.updateProjectionMatrix();
  }

  base() {
    return new this.three.Vector3().fromArray(this.robot.data.xpos, 3 * this.robot.about.base);
  }

  // A large piece of the first plane, which follows the robot tile by tile; without a plane, of z.
  ground(plane, lowest) {
    const {three, robot} = this, {geom_xmat, geom_xpos} = robot.data;
    this.cell = [0.1, 0.2, 0.5, 1, 2, 5].find(each => each > 0.35 * this.size) ?? 10;
    this.floor = new three.Mesh(new three.PlaneGeometry(160 * this.cell, 160 * this.cell),
                                new three.MeshStandardMaterial({roughness: 0.95}));
    this.floor.receiveShadow = true;
    this.level = new three.Matrix4().setPosition(0, 0, lowest - 0.02 * this.size);
    if (plane !== undefined) this.level = pose(three, geom_xmat, geom_xpos, plane);
    this.floor.quaternion.setFromRotationMatrix(this.level);
    this.scene.add(this.floor);
  }

  // A picture of two by two tiles with thin lines between them.
  tile(dark) {
    const canvas = document.createElement("canvas"), pen = canvas.getContext("2d"), n = 256;
    canvas.width = canvas.height = n;
    for (const [x, y] of [[0, 0], [1, 0], [0, 1], [1, 1]]) {
      pen.fillStyle = dark ? ["#262d36", "#2a323c"][x ^ y] : ["#dde4ec", "#d5dde6"][x ^ y];
      pen.fillRect(x * n / 2, y * n / 2, n / 2, n / 2);
    }
    pen.strokeStyle = dark ? "#3a4552" : "#bcc8d4";
    pen.lineWidth = 2;
    pen.strokeRect(0, 0, n, n);
    pen.strokeRect(n / 2, -1, n / 2, n + 2);
    pen.strokeRect(-1, n / 2, n + 2, n / 2);
    const map = new this.three.CanvasTexture(canvas);
    map.wrapS = map.wrapT = this.three.RepeatWrapping;
    map.repeat.set(80, 80);
    map.colorSpace = this.three.SRGBColorSpace;
    map.anisotropy = this.renderer.capabilities.getMaxAnisotropy();
    return map;
  }

  place() {
    const {geom_xmat, geom_xpos} = this.robot.data;
    for (const part of this.parts) {
      part.matrix.copy(pose(this.three, geom_xmat, geom_xpos, part.userData.geom));
      part.updateMatrixWorld(true);
    }
  }

  draw() {
    const {robot, orbit, camera, sun, size} = this;
    robot.mujoco.mj_kinematics(robot.model, robot.data);
    this.place();
    const goal = this.base().add(this.offset);
    goal.z += (orbit.target.z - goal.z) * 0.9;  // it bounces less than the robot
    const moved = goal.sub(orbit.target);
    orbit.target.add(moved);
    camera.position.add(moved);
    orbit.update();
    sun.target.position.copy(orbit.target);
    sun.position.copy(orbit.target).add(new this.three.Vector3(-2.2, -1.6, 4.4).multiplyScalar(size));
    const back = this.level.clone().invert(), near = orbit.target.clone().applyMatrix4(back);
    const snap = v => 2 * this.cell * Math.round(v / (2 * this.cell));
    this.floor.position.set(snap(near.x), snap(near.y), 0).applyMatrix4(this.level);
    this.renderer.render(this.scene, camera);
  }

  // Shows a force or a pull from one point to another, or nothing.
  point(from, to) {
    this.arrow.visible = Boolean(from) && from.distanceTo(to) > 1e-3;
    if (!this.arrow.visible) return;
    const way = to.clone().sub(from), length = way.length(), head = Math.min(length, 0.25 * this.size);
    this.arrow.position.copy(from);
    this.arrow.setDirection(way.normalize());
    this.arrow.setLength(length, head, 0.6 * head);
  }

  aim(event) {
    const box = $("view").getBoundingClientRect();
    const x = (event.clientX - box.left) / box.width, y = (event.clientY - box.top) / box.height;
    this.ray.setFromCamera(new this.three.Vector2(2 * x - 1, 1 - 2 * y), this.camera);
    return this.ray;
  }
}

function pose(three, turns, places, i) {
  const [a, b, c, d, e, f, g, h, k] = turns.subarray(9 * i), [x, y, z] = places.subarray(3 * i);
  return new three.Matrix4().set(a, b, c, x, d, e, f, y, g, h, k, z, 0, 0, 0, 1);
}

// A drag of the robot pulls at a point of it like a spring.
class Hand {
  constructor(view) {
    const {robot, three} = view, canvas = $("view");
    const point = (places, i) => new three.Vector3().fromArray(places, 3 * i);
    let grip = null;  // the body, the point in its frame, and the plane in which the hand moves
    canvas.addEventListener("pointerdown", event => {
      const hit = view.aim(event).intersectObjects(view.parts)
        .find(({object}) => robot.model.body_weldid[object.userData.body] > 0);
      if (!hit || event.button) return;
      const {body} = hit.object.userData, frame = pose(three, robot.data.xmat, robot.data.xpos, body);
      const across = view.camera.getWorldDirection(new three.Vector3());
      grip = {body, local: hit.point.clone().applyMatrix4(frame.invert()), goal: hit.point.clone(),
              plane: new three.Plane().setFromNormalAndCoplanarPoint(across, hit.point)};
      view.orbit.enabled = false;
      canvas.setPointerCapture(event.pointerId);
      event.stopImmediatePropagation();
    }, true);
    canvas.addEventListener("pointermove", event => {
      if (grip) view.aim(event).ray.intersectPlane(grip.plane, grip.goal);
    });
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"])
      canvas.addEventListener(kind, () => { grip = null; view.orbit.enabled = true; });
    const held = () => grip.local.clone().applyMatrix4(
      pose(three, robot.data.xmat, robot.data.xpos, grip.body));
    let before = null;
    this.pull = applied => {
      if (!grip) { before = null; return; }
      const at = held(), moved = at.clone().sub(before ?? at);
      before = at;
      const force = grip.goal.clone().sub(at).multiplyScalar(60 * robot.mass)
        .addScaledVector(moved, -6 * robot.mass / robot.timestep).clampLength(0, 15 * robot.mass);
      const torque = at.clone().sub(point(robot.data.xipos, grip.body)).cross(force);
      [...force, ...torque].forEach((v, i) => { applied[6 * grip.body + i] += v; });
    };
    this.show = () => {
      if (grip) return view.point(held(), grip.goal);
      if (robot.pushed <= 0) return view.point(null);
      const at = point(robot.data.xipos, robot.about.pushed);
      const way = new three.Vector3(...robot.force).multiplyScalar(0.1 * view.size / robot.mass);
      return view.point(at.clone().sub(way), at);
    };
  }
}
