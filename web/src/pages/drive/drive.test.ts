import { describe, expect, it } from 'vitest';
import {
  type Axis,
  mappingOf,
  ofKeys,
  ofPad,
  ofStick,
  REST,
  shaped,
  speedsOf,
  together,
  unitOfAcceleration,
} from './axes';
import { DeadMan, REPEAT_LOST_MS } from './deadman';
import { Pace, PERIOD_MS, SOONEST_MS } from './pace';

const axis = (name: string, speed = 1): Axis => ({ name, unit: '', speed, acceleration: 1, deceleration: 1, jerk: 1 });
const TWO = [axis('linear', 0.5), axis('angular', 2)];
const stick = (x: number, y: number, ...held: number[]) => ({
  axes: [x, y, 0, 0],
  pressed: Array.from({ length: 16 }, (_, place) => held.includes(place)),
  standard: true,
});

describe('keys', () => {
  it('move a control as far as it goes, by their place on the keyboard', () => {
    expect(ofKeys(['KeyW'])).toEqual({ ...REST, ahead: 1 });
    expect(ofKeys(['ArrowDown', 'ArrowLeft'])).toEqual({ ...REST, ahead: -1, turn: 1 });
    expect(ofKeys(['KeyX', 'Digit1'])).toEqual(REST);
  });

  it('against each other are none, and two for the same are one', () => {
    expect(ofKeys(['KeyW', 'KeyS'])).toEqual(REST);
    expect(ofKeys(['KeyW', 'ArrowUp'])).toEqual({ ...REST, ahead: 1 });
  });
});

describe('pad and stick', () => {
  it('are dead in the middle, gentle near it, and reach the end', () => {
    expect(shaped(0.1, 0.15)).toBe(0);
    expect(shaped(0.575, 0.15)).toBeCloseTo(0.25);
    expect(shaped(-1, 0.15)).toBe(-1);
    expect(shaped(7, 0.15)).toBe(1);
    expect(shaped(NaN, 0.15)).toBe(0);
  });

  it('to the right is a turn to the right', () => {
    expect(ofPad({ x: 1, y: 0 }).turn).toBe(-1);
    expect(ofPad({ x: 0, y: 1 }).ahead).toBe(1);
    expect(ofPad(null)).toEqual(REST);
  });

  it('a stick drives only while a shoulder button is held', () => {
    expect(ofStick(stick(0, -1))).toEqual(REST);
    expect(ofStick(stick(0, -1, 0))).toEqual(REST);
    expect(ofStick(stick(0, -1, 4)).ahead).toBe(1);
    expect(ofStick({ ...stick(0, -1, 0), standard: false }).ahead).toBe(1);
  });
});

describe('axes', () => {
  it('are found by name, else in their order', () => {
    expect(mappingOf(TWO)).toEqual({ ahead: 0, turn: 1, third: -1 });
    expect(mappingOf([axis('yaw'), axis('y'), axis('x')])).toEqual({ ahead: 2, turn: 0, third: 1 });
    expect(mappingOf([axis('joint_a')])).toEqual({ ahead: 0, turn: -1, third: -1 });
    expect(mappingOf([axis('a'), axis('b'), axis('c'), axis('d')])).toEqual({ ahead: 0, turn: 1, third: 2 });
    expect(mappingOf([])).toEqual({ ahead: -1, turn: -1, third: -1 });
  });

  it('get their share of the speed, and never more than it', () => {
    expect(speedsOf({ ahead: 1, turn: -0.5, third: 1 }, TWO, mappingOf(TWO), 0.5)).toEqual([0.25, -0.5]);
    expect(speedsOf({ ahead: 1, turn: 0, third: 1 }, [TWO[0]!], { ahead: 0, turn: -1, third: 0 }, 3)).toEqual([0.5]);
    expect(speedsOf(REST, TWO, mappingOf(TWO), 1).map((one) => Object.is(one, 0))).toEqual([true, true]);
  });

  it('accelerate in the unit of their speed by the second', () => {
    expect(['m/s', 'rad/s', 'rpm', ''].map(unitOfAcceleration)).toEqual(['m/s²', 'rad/s²', 'rpm/s', '1/s']);
  });

  it('two hands add up to the end', () => {
    expect(together(ofKeys(['KeyW']), ofPad({ x: 0, y: 1 })).ahead).toBe(1);
  });
});

describe('the dead man', () => {
  it('wishes while a key is held', () => {
    const man = new DeadMan(300, 0);
    man.keyDown('KeyW', false, 0);
    expect(man.deflection.ahead).toBe(1);
    man.keyUp('KeyW');
    expect(man.deflection).toEqual(REST);
  });

  it('takes no key that was down before', () => {
    const man = new DeadMan(300, 0);
    man.keyDown('KeyW', true, 0);
    expect(man.deflection).toEqual(REST);
  });

  it('takes a key for released whose repetition ends without a word', () => {
    const man = new DeadMan(300, 0);
    man.keyDown('KeyW', false, 0);
    man.keyDown('KeyW', true, 500);
    man.check(500 + REPEAT_LOST_MS);
    expect(man.deflection.ahead).toBe(1);
    man.check(501 + REPEAT_LOST_MS);
    expect(man.deflection).toEqual(REST);
  });

  it('expects no repetition of a key once another one was pressed or released', () => {
    const man = new DeadMan(300, 0);
    man.keyDown('KeyW', false, 0);
    man.keyDown('KeyW', true, 500);
    man.keyDown('KeyA', false, 600);
    man.check(600 + 2 * REPEAT_LOST_MS);
    expect(man.deflection.ahead).toBe(1);
    man.keyDown('KeyW', true, 2100);
    man.keyUp('KeyA');
    man.check(2100 + 2 * REPEAT_LOST_MS);
    expect(man.deflection.ahead).toBe(1);
  });

  it('lets go of all at once', () => {
    const man = new DeadMan(300, 0);
    man.keyDown('KeyW', false, 0);
    man.pad({ x: 1, y: 1 });
    man.gamepad(stick(0, 0));
    man.gamepad(stick(0, 1, 4));
    man.letGo();
    expect(man.deflection).toEqual(REST);
  });

  it('ends when nothing is heard for as long as the bridge would wait', () => {
    const man = new DeadMan(300, 0);
    for (let now = 40; now < 1000; now += 40) {
      man.heard(now);
      expect(man.check(now)).toBe(null);
    }
    expect(man.check(1250)).toBe(null);
    expect(man.age(1260)).toBe(300);
    expect(man.check(1300)).toBe('stale');
  });

  it('ends when the page stood, whatever has come meanwhile', () => {
    const man = new DeadMan(300, 0);
    expect(man.check(40)).toBe(null);
    man.heard(340);
    expect(man.check(340)).toBe('stood');
  });

  it('ends with a gamepad that drove, and with no other', () => {
    const man = new DeadMan(300, 0);
    man.gamepad(stick(0, 0));
    expect(man.gamepad(null)).toBe(null);
    man.gamepad(stick(0, 0));
    man.gamepad(stick(0, -1, 5));
    expect(man.deflection.ahead).toBe(1);
    expect(man.gamepad(null)).toBe('gamepad_lost');
    expect(man.deflection).toEqual(REST);
  });

  it('follows no stick that was held before it was seen at rest', () => {
    const man = new DeadMan(300, 0);
    man.gamepad(stick(0, -1, 4));
    expect(man.deflection).toEqual(REST);
    man.gamepad(stick(0, -1));
    man.gamepad(stick(0, -1, 4));
    expect(man.deflection.ahead).toBe(1);
  });
});

describe('the pace', () => {
  it('sends a wish that stands each period, and one that changes at once', () => {
    const pace = new Pace();
    expect(pace.due([0, 0], 0)).toBe(0);
    expect(pace.send([0, 0], 0)).toBe(1);
    expect(pace.due([0, 0], 10)).toBe(PERIOD_MS - 10);
    expect(pace.due([1, 0], 20)).toBe(0);
    expect(pace.due([1, 0], 5)).toBe(SOONEST_MS - 5);
    expect(pace.due([0, 0], PERIOD_MS)).toBe(0);
  });

  it('knows how long the newest took', () => {
    const pace = new Pace();
    for (const now of [0, 40, 80]) pace.send([0], now);
    pace.told(2, 0, 47);
    expect([pace.server_ms, pace.bridge_ms]).toEqual([7, null]);
    pace.told(3, 2, 100);
    expect([pace.server_ms, pace.bridge_ms]).toEqual([20, 60]);
    pace.told(3, 2, 500);
    expect([pace.server_ms, pace.bridge_ms]).toEqual([20, 60]);
  });
});
