/** Numbers as the path of a line in SVG, lowest at the bottom; a gap is where there is none. */
export function linePath(values: readonly (number | null)[], width: number, height: number): string {
  const real = values.filter((one): one is number => one !== null && Number.isFinite(one));
  if (real.length === 0) return '';
  const low = Math.min(...real);
  const high = Math.max(...real);
  const step = values.length > 1 ? (width - 2) / (values.length - 1) : 0;
  let path = '';
  let broken = true;
  values.forEach((one, at) => {
    if (one === null || !Number.isFinite(one)) {
      broken = true;
      return;
    }
    const x = (1 + at * step).toFixed(1);
    const part = high === low ? 0.5 : (one - low) / (high - low);
    const y = (height - 2 - part * (height - 4)).toFixed(1);
    path += `${broken ? 'M' : 'L'}${x} ${y}`;
    // A single point between gaps is a dot.
    if (broken) path += 'h.1';
    broken = false;
  });
  return path;
}
