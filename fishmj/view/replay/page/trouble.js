window.addEventListener("error", function (event) {
  document.body.dataset.error = event.message;
  var box = document.getElementById("trouble");
  box.hidden = false;
  box.textContent = /webgl/i.test(event.message) ? "This browser shows no WebGL, which MeshCat needs." : event.message;
});
