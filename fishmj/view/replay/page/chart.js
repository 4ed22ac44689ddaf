// Distance to the target over time, or, where the log has no target, speed over ground; drag to seek.
class Chart {
  constructor(canvas, tracks, duration, seek) {
    this.canvas = canvas; this.tracks = tracks; this.duration = duration;
    this.top = 0.2;
    this.aimed = tracks.some(track => track.distance.some(isFinite));
    this.key = this.aimed ? "distance" : "speed";
    for (const track of tracks) for (const d of track[this.key]) if (isFinite(d)) this.top = Math.max(this.top, d);
    this.top *= 1.08;
    const jump = event => {
      const box = canvas.getBoundingClientRect();
      seek(this.duration * Math.min(1, Math.max(0, (event.clientX - box.left - this.left) / (box.width - this.left - 8))));
    };
    this.left = 44;
    canvas.addEventListener("pointerdown", event => { canvas.setPointerCapture(event.pointerId); jump(event); });
    canvas.addEventListener("pointermove", event => { if (event.buttons) jump(event); });
    new ResizeObserver(() => this.paint()).observe(canvas);
  }

  paint() {  // the curves, once a resize; the cursor is drawn over a copy
    const ratio = window.devicePixelRatio || 1, w = this.canvas.clientWidth, h = this.canvas.clientHeight;
    this.canvas.width = w * ratio; this.canvas.height = h * ratio;
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    const X = t => this.left + (w - this.left - 8) * t / this.duration, Y = d => h - 15 - (h - 23) * d / this.top;
    pen.font = "11px system-ui, sans-serif";
    pen.fillStyle = "rgba(234,244,248,.75)";
    pen.strokeStyle = "rgba(255,255,255,.14)";
    const step = [0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 50].find(s => this.top / s <= 4.5) || 100;
    for (let d = 0; d <= this.top; d += step) {
      pen.beginPath(); pen.moveTo(this.left, Y(d)); pen.lineTo(w - 8, Y(d)); pen.stroke();
      pen.fillText(d.toFixed(step < 0.1 ? 2 : 1) + (this.aimed ? " m" : ""), 4, Y(d) + 4);
    }
    const room = Math.min(14, (w - this.left) / 42);  // labels beside each other
    const gap = [0.5, 1, 2, 5, 10, 30, 60, 300].find(s => this.duration / s <= room) || 600;
    for (let t = 0; t <= this.duration; t += gap) pen.fillText(t + " s", X(t) - 5, h - 2);
    pen.fillText(this.aimed ? "distance to the target" : "speed over ground, m/s", w - 150, 11);
    if (this.aimed) {
      pen.setLineDash([5, 4]);
      pen.strokeStyle = "#53e07a";
      pen.beginPath(); pen.moveTo(this.left, Y(data.arrival)); pen.lineTo(w - 8, Y(data.arrival)); pen.stroke();
      pen.setLineDash([]);
    }
    this.tracks.forEach((track, k) => {
      pen.strokeStyle = track.colour;
      pen.lineWidth = k ? 1.4 : 2;
      pen.beginPath();
      for (let i = 0; i < track.frames; i++) {
        const x = X(track.duration * i / (track.frames - 1)), d = track[this.key][i];
        if (isFinite(d)) i ? pen.lineTo(x, Y(d)) : pen.moveTo(x, Y(d));
      }
      pen.stroke();
    });
    this.still = pen.getImageData(0, 0, this.canvas.width, this.canvas.height);
    this.X = X; this.Y = Y;
    this.cursor(this.time || 0);
  }

  cursor(time) {
    this.time = time;
    if (!this.still) return;
    const pen = this.canvas.getContext("2d"), x = this.X(time);
    pen.putImageData(this.still, 0, 0);
    pen.strokeStyle = "rgba(255,255,255,.85)";
    pen.lineWidth = 1.2;
    pen.beginPath(); pen.moveTo(x, 4); pen.lineTo(x, this.canvas.clientHeight - 14); pen.stroke();
    this.tracks.forEach(track => {
      const d = track[this.key][Math.min(track.frames - 1, Math.round(time / track.duration * (track.frames - 1)))];
      if (!isFinite(d) || time > track.duration + 1e-6) return;
      pen.fillStyle = track.colour;
      pen.beginPath(); pen.arc(x, this.Y(d), 4, 0, 7); pen.fill();
    });
  }
}
