// One fish: skin, trail, target ring and the arrow of the water around it.

// p = H_h + R(phi_h + s j_h) (r - h_rest): each vertex turns about its nearest hinge by a share of the hinge's angle.
class Fish {
  constructor(index, track, skin) {
    this.track = track;
    this.rest = decode(skin.vertices, Float32Array);
    this.restNormals = decode(skin.normals, Float32Array);
    this.hinge = decode(skin.hinge, Uint32Array);
    this.share = decode(skin.share, Float32Array);
    this.hingeX = skin.hingeX;
    this.state = new Float64Array(track.nq);
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(this.rest.slice(), 3));
    geometry.setAttribute("normal", new THREE.BufferAttribute(this.restNormals.slice(), 3));
    geometry.setAttribute("color", new THREE.BufferAttribute(this.tinted(decode(skin.colour, Float32Array), index), 3));
    geometry.setIndex(new THREE.BufferAttribute(decode(skin.faces, Uint32Array), 1));
    const ghost = index > 0;
    const material = new THREE.MeshPhongMaterial({
      vertexColors: true, shininess: 42, specular: 0x1b1e22, side: THREE.DoubleSide, transparent: ghost, opacity: ghost ? 0.6 : 1});
    this.mesh = put(`fish/${index + 1}`, new THREE.Mesh(geometry, material));
    this.mesh.castShadow = true;
    this.mesh.frustumCulled = false;
    this.buildTrail(index);
    this.buildTarget(index);
    this.wind = put(`water/at_fish_${index + 1}`, arrowMesh(0x7ef0ff, 0.9));
  }

  tinted(colour, index) {  // overlaid fish take their track's colour, so that they are told apart
    if (index === 0) return colour;
    const tint = new THREE.Color(this.track.colour);
    for (let i = 0; i < colour.length; i += 3) {
      colour[i] = 0.35 * colour[i] + 0.65 * tint.r;
      colour[i + 1] = 0.35 * colour[i + 1] + 0.65 * tint.g;
      colour[i + 2] = 0.35 * colour[i + 2] + 0.65 * tint.b;
    }
    return colour;
  }

  buildTrail(index) {  // a ribbon on the whole path, of which the part up to now is drawn
    const {q, nq, frames, colour} = this.track, points = new Float32Array(6 * frames), faces = new Uint32Array(6 * (frames - 1));
    for (let i = 0; i < frames; i++) {
      const a = Math.max(i - 1, 0) * nq, b = Math.min(i + 1, frames - 1) * nq;
      const dx = q[b] - q[a], dy = q[b + 1] - q[a + 1], scale = 0.0045 / Math.max(Math.hypot(dx, dy), 1e-9);
      const x = q[i * nq], y = q[i * nq + 1], z = -0.004 - 0.002 * index;
      points.set([x - dy * scale, y + dx * scale, z, x + dy * scale, y - dx * scale, z], 6 * i);
      if (i) faces.set([2 * i - 2, 2 * i - 1, 2 * i, 2 * i, 2 * i - 1, 2 * i + 1], 6 * (i - 1));
    }
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(points, 3));
    geometry.setIndex(new THREE.BufferAttribute(faces, 1));
    this.trail = put(`trail/${index + 1}`, new THREE.Mesh(geometry, new THREE.MeshBasicMaterial(
      {color: colour, transparent: true, opacity: 0.55, side: THREE.DoubleSide, depthWrite: false})));
    this.trail.frustumCulled = false;
  }

  buildTarget(index) {
    this.target = put(`target/${index + 1}`, new THREE.Group());
    const ring = new THREE.Mesh(new THREE.TorusGeometry(data.arrival, 0.0055, 14, 72), new THREE.MeshPhongMaterial({color: 0xf08a1d, emissive: 0x3a1800}));
    const disc = new THREE.Mesh(new THREE.CircleGeometry(data.arrival, 48), new THREE.MeshBasicMaterial(
      {color: 0xffb347, transparent: true, opacity: 0.22, side: THREE.DoubleSide, depthWrite: false}));
    const pole = new THREE.Mesh(new THREE.CylinderGeometry(0.003, 0.003, -DEPTH, 10), new THREE.MeshPhongMaterial({color: 0xffc069}));
    pole.rotation.x = Math.PI / 2;
    pole.position.z = DEPTH / 2;
    const core = new THREE.Mesh(new THREE.SphereGeometry(0.013, 18, 14), new THREE.MeshPhongMaterial({color: 0xffe0a8, emissive: 0x8a5200}));
    this.target.add(ring, disc, pole, core);
    this.glow = [ring.material, disc.material];
  }

  at(array, width, frame, column) {  // linear between frames
    const last = this.track.frames - 1, f = Math.min(Math.max(frame, 0), last), i = Math.min(Math.floor(f), last - 1), u = f - i;
    return (1 - u) * array[i * width + column] + u * array[(i + 1) * width + column];
  }

  move(frame) {
    const {nq, q, target, flow} = this.track, s = this.state;
    for (let k = 0; k < nq; k++) s[k] = this.at(q, nq, frame, k);
    this.bend(s);
    this.trail.geometry.setDrawRange(0, 6 * Math.max(0, Math.min(Math.floor(frame), this.track.frames - 1)));
    const tx = this.at(target, 2, frame, 0), ty = this.at(target, 2, frame, 1);
    this.target.visible = isFinite(tx);
    if (isFinite(tx)) {
      this.target.position.set(tx, ty, 0);
      const inside = Math.hypot(tx - s[0], ty - s[1]) <= data.arrival;
      this.glow.forEach(m => m.color.set(inside ? 0x3fd46a : 0xf08a1d));
      this.glow[0].emissive.set(inside ? 0x0d4a20 : 0x3a1800);
    }
    const ux = this.at(flow, 2, frame, 0), uy = this.at(flow, 2, frame, 1), speed = Math.hypot(ux, uy);
    this.wind.visible = speed > 1e-3;
    if (this.wind.visible) {
      this.wind.position.set(s[0], s[1], 0.1);
      this.wind.rotation.z = Math.atan2(uy, ux);
      this.wind.scale.set(Math.min(0.6, 0.05 + 0.8 * speed), 0.13, 1);
    }
  }

  bend(s) {
    const n = this.hingeX.length, hx = [], hy = [], phi = [];
    let x = s[0], y = s[1], angle = s[2], before = 0;
    for (let h = 0; h < n; h++) {
      if (h) angle += s[2 + h];
      x += (this.hingeX[h] - before) * Math.cos(angle);
      y += (this.hingeX[h] - before) * Math.sin(angle);
      before = this.hingeX[h];
      hx.push(x); hy.push(y); phi.push(angle);
    }
    const {position, normal} = this.mesh.geometry.attributes, p = position.array, m = normal.array, r = this.rest, w = this.restNormals;
    for (let i = 0, k = 0; i < this.hinge.length; i++, k += 3) {
      const h = this.hinge[i], a = phi[h] + this.share[i] * s[3 + h], c = Math.cos(a), d = Math.sin(a), dx = r[k] - this.hingeX[h];
      p[k] = hx[h] + c * dx - d * r[k + 1];
      p[k + 1] = hy[h] + d * dx + c * r[k + 1];
      m[k] = c * w[k] - d * w[k + 1];
      m[k + 1] = d * w[k] + c * w[k + 1];
    }
    position.needsUpdate = normal.needsUpdate = true;
  }
}
