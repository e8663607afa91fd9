/** How abnormal something is. `normal` has no colour, `off` is not there. */
export type Tone = 'normal' | 'off' | 'active' | 'ok' | 'warn' | 'alarm' | 'unsure' | 'old';
