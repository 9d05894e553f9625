// The map from above: a window on the cells. Cells are counted from the outer corner of the upper left one.

/// A window on a field of `width` x `height` cells.
function planView(width, height) {
  const view = { x: width / 2, y: height / 2, scale: 1, fitted: true };
  view.fit = (w, h, free) => {
    const [left, right, top, bottom] = free;
    view.scale = Math.max(0.02, Math.min((w - left - right) / width, (h - top - bottom) / height));
    view.x = width / 2 - (left - right) / 2 / view.scale;
    view.y = height / 2 - (top - bottom) / 2 / view.scale;
    view.fitted = true;
  };
  view.toCell = (px, py, w, h) => [view.x + (px - w / 2) / view.scale, view.y + (py - h / 2) / view.scale];
  view.toPixel = (x, y, w, h) => [(x - view.x) * view.scale + w / 2, (y - view.y) * view.scale + h / 2];
  view.zoom = (factor, px, py, w, h) => {
    const [x, y] = view.toCell(px, py, w, h);
    view.scale = Math.max(0.05, Math.min(60, view.scale * factor));
    view.x = x - (px - w / 2) / view.scale;
    view.y = y - (py - h / 2) / view.scale;
    view.fitted = false;
  };
  view.move = (dx, dy) => {
    view.x = Math.max(0, Math.min(width, view.x - dx / view.scale));
    view.y = Math.max(0, Math.min(height, view.y - dy / view.scale));
    view.fitted = false;
  };
  /// Draws two pictures of the cells, the second to the right of the column `split`.
  view.draw = (context, w, h, first, second, split) => {
    const [left, top] = view.toPixel(0, 0, w, h);
    context.imageSmoothingEnabled = view.scale < 5;
    context.imageSmoothingQuality = "high";
    context.drawImage(first, left, top, width * view.scale, height * view.scale);
    if (!second) return;
    context.save();
    context.beginPath();
    context.rect(split, 0, w - split, h);
    context.clip();
    context.drawImage(second, left, top, width * view.scale, height * view.scale);
    context.restore();
  };
  return view;
}
