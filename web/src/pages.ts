/**
 * The pages, in the order of the navigation. A page is one line here, a folder in `pages/` and its section in
 * `texts/en.json`; one that is not there yet has no line. Its script is loaded when it is opened.
 */
import type { Component } from 'svelte';
import type { TextKey } from './lib/texts';
import type { IconName } from './parts/icons';

export interface Page {
  name: string;
  title: TextKey;
  icon: IconName;
  /** Whether it is reached from other pages only, as that of one robot. */
  hidden?: boolean;
  load: () => Promise<{ default: Component }>;
}

// prettier-ignore
export const pages: readonly Page[] = [
  { name: 'fleet', title: 'fleet.title', icon: 'fleet', load: () => import('./pages/fleet/Fleet.svelte') },
  { name: 'map', title: 'map.title', icon: 'map', load: () => import('./pages/map/Map.svelte') },
  { name: 'scenarios', title: 'scenarios.title', icon: 'scenarios', load: () => import('./pages/scenarios/Scenarios.svelte') },
  { name: 'drive', title: 'drive.title', icon: 'drive', hidden: true, load: () => import('./pages/drive/Drive.svelte') },
  { name: 'robot', title: 'robot.title', icon: 'robot', hidden: true, load: () => import('./pages/robot/Robot.svelte') },
  { name: 'resilience', title: 'resilience.title', icon: 'resilience', load: () => import('./pages/resilience/Resilience.svelte') },
  { name: 'alarms', title: 'alarms.title', icon: 'alarms', load: () => import('./pages/alarms/Alarms.svelte') },
  { name: 'space', title: 'space.title', icon: 'space', load: () => import('./pages/space/Space.svelte') },
  { name: 'pubsub', title: 'pubsub.title', icon: 'pubsub', load: () => import('./pages/pubsub/PubSub.svelte') },
];
