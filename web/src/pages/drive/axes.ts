/**
 * From hands to speeds. Pure.
 *
 * Three controls reach from -1 to 1: `ahead` (W, S, up, down), `turn` (A, D, left, right; left is positive, as ROS has it) and
 * `third` (Q, E). Each drives one axis of the robot, as far as the share of its speed that the operator has chosen.
 */

/** An axis of a robot, as the feed `teleoperation` and the lease tell it. */
export interface Axis {
  name: string;
  unit: string;
  speed: number;
  acceleration: number;
  deceleration: number;
  jerk: number;
}

export type Control = 'ahead' | 'turn' | 'third';
export const CONTROLS: readonly Control[] = ['ahead', 'turn', 'third'];

/** How far each control is moved. */
export type Deflection = Record<Control, number>;
export const REST: Readonly<Deflection> = { ahead: 0, turn: 0, third: 0 };

/** Keys by their place on the keyboard, whatever letters are on them. */
const KEYS: Readonly<Record<string, readonly [Control, number]>> = {
  KeyW: ['ahead', 1],
  ArrowUp: ['ahead', 1],
  KeyS: ['ahead', -1],
  ArrowDown: ['ahead', -1],
  KeyA: ['turn', 1],
  ArrowLeft: ['turn', 1],
  KeyD: ['turn', -1],
  ArrowRight: ['turn', -1],
  KeyQ: ['third', 1],
  KeyE: ['third', -1],
};

export const isDriveKey = (code: string): boolean => code in KEYS;

/** Keys against each other are none. */
export function ofKeys(codes: Iterable<string>): Deflection {
  const sum = { ...REST };
  for (const code of codes) {
    const key = KEYS[code];
    if (key) sum[key[0]] += key[1];
  }
  return mapped((control) => clamp(sum[control]));
}

const PAD_DEAD = 0.08;
const STICK_DEAD = 0.15;

/** Where the pad is touched, from -1 to 1 to the right and upwards. */
export function ofPad(pad: { x: number; y: number } | null): Deflection {
  return pad ? { ahead: shaped(pad.y, PAD_DEAD), turn: shaped(-pad.x, PAD_DEAD), third: 0 } : { ...REST };
}

/** What a gamepad shows; `axes` and `buttons` as its mapping "standard" has them. */
export interface Sample {
  axes: readonly number[];
  pressed: readonly boolean[];
  standard: boolean;
}

/** Shoulder buttons and triggers: while none of them is held, a stick drives nothing. Of another mapping: any button. */
export function isEnabled(sample: Sample): boolean {
  return sample.standard ? sample.pressed.slice(4, 8).some(Boolean) : sample.pressed.some(Boolean);
}

/** The left stick drives two controls, the right one the third. */
export function ofStick(sample: Sample | null): Deflection {
  if (!sample || !isEnabled(sample)) return { ...REST };
  const [x = 0, y = 0, z = 0] = sample.axes;
  return { ahead: shaped(-y, STICK_DEAD), turn: shaped(-x, STICK_DEAD), third: shaped(-z, STICK_DEAD) };
}

/** A stick at rest is seldom at zero, and small speeds want more of its way: dead near the middle, then quadratic. */
export function shaped(value: number, dead: number): number {
  if (!Number.isFinite(value)) return 0;
  const size = Math.min(Math.abs(value), 1);
  return size <= dead ? 0 : Math.sign(value) * ((size - dead) / (1 - dead)) ** 2;
}

export function together(...parts: readonly Deflection[]): Deflection {
  return mapped((control) => clamp(parts.reduce((sum, part) => sum + part[control], 0)));
}

/** Which axis each control drives; -1: none. */
export type Mapping = Record<Control, number>;

const AHEAD = /^(linear|linear_x|x|forward|ahead|vx|speed|translation)$/i;
const TURN = /^(angular|angular_z|yaw|turn|rotation|steering|wz|rz)$/i;

/** By their names where these say it, else in their order. */
export function mappingOf(axes: readonly Axis[]): Mapping {
  const free = axes.map((_, place) => place);
  const take = (wanted: RegExp | null): number => {
    const at = wanted ? free.findIndex((place) => wanted.test(axes[place]?.name ?? '')) : 0;
    return at < 0 || !free.length ? -1 : (free.splice(at, 1)[0] ?? -1);
  };
  let ahead = take(AHEAD);
  let turn = take(TURN);
  if (ahead < 0) ahead = take(null);
  if (turn < 0) turn = take(null);
  return { ahead, turn, third: take(null) };
}

/** Speeds by axis. Controls of the same axis add up, to its limit at most. */
export function speedsOf(deflection: Deflection, axes: readonly Axis[], mapping: Mapping, share: number): number[] {
  return axes.map((axis, place) => {
    const sum = CONTROLS.reduce((all, control) => all + (mapping[control] === place ? deflection[control] : 0), 0);
    const speed = clamp(sum) * clamp(share) * axis.speed;
    return speed === 0 ? 0 : speed; // no -0
  });
}

function clamp(value: number): number {
  return Math.min(Math.max(value, -1), 1);
}

function mapped(value: (control: Control) => number): Deflection {
  return { ahead: value('ahead'), turn: value('turn'), third: value('third') };
}

/** The unit of an acceleration, by that of the speed. */
export function unitOfAcceleration(unit: string): string {
  if (unit.endsWith('/s')) return `${unit}²`;
  return unit ? `${unit}/s` : '1/s';
}
