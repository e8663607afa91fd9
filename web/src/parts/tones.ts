/** How abnormal something is. `normal` has no colour. */
export type Tone = 'normal' | 'active' | 'ok' | 'warn' | 'alarm' | 'unsure' | 'old';
