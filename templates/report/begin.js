// Beginning, and paper.
let closed = [];
window.addEventListener("beforeprint", () => {
  closed = [...document.querySelectorAll("details:not([open])")];
  for (const details of closed) details.open = true;
  for (const draw of forPaper) draw();
});
window.addEventListener("afterprint", () => {
  for (const details of closed) details.open = false;
});

resize();
showPart();
work(400);
show();
new ResizeObserver(resize).observe(canvas);
