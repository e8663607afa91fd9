/** Pixels at the size of text that the page is made for, as pixels at the size that this browser has. */
const MADE_FOR_PX = 14;

let factor = 0;

export function scaled(pixels: number): number {
  factor ||= parseFloat(getComputedStyle(document.documentElement).fontSize) / MADE_FOR_PX || 1;
  return Math.round(pixels * factor);
}
