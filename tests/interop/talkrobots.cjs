// A foreign OPC UA client has the nine tasks of TalkRoBots done, by Methods alone: it validates and runs the scenario,
// sees its steps and Ridgeback's fault, asks who would take over, chooses the second best, and sees the end.
// Arguments: endpoint URL, user, password, folder for its certificates. Prints one JSON object.
"use strict";

const { call, readValue, report, text, texts, watchEvents } = require("./foreign.cjs");

report(async (session, made) => {
  const watching = await watchEvents(session, made.events, 90000);
  const { seen } = watching;
  const [valid, problems] = (await call(session, "Scenarios", "Validate", text("nine_tasks"))).output;
  made.validated = { valid, problems };
  const [runId] = (await call(session, "Scenarios", "Run", text("nine_tasks"), texts([]), texts([]))).output;
  made.runId = runId;
  await seen((event) => event.fact === "TaskAssigned" && event.task === "fetch");
  const [, tasks, best] = (await call(session, "Resilience", "WhatIf", text("ridgeback"))).output;
  made.whatIf = { tasks, best };
  made.alarm = await seen((event) => event.active === true && event.source === "ns=2;s=Robots.ridgeback");
  const open = await seen((event) => event.decisionState === "open");
  const decision = `ns=2;s=Fleet.Resilience.Decisions.${open.decision}`;
  made.ranking = {};
  for (const name of ["Robots", "Scores", "Criteria", "Weights", "RawValues", "CriterionScores", "Excluded", "Reasons"]) {
    made.ranking[name] = Array.from(await readValue(session, `${decision}.${name}`));
  }
  const chosen = made.ranking.Robots[1];
  made.confirmed = (await call(session, "Resilience", "Confirm", text(open.decision), text(chosen))).output;
  await seen((event) => event.run === runId && event.state === "done");
  made.taken = Array.from(await readValue(session, "ns=2;s=Fleet.Faults.ridgeback.announced.Capacities"));
  made.robotState = await readValue(session, "ns=2;s=Robots.ridgeback.State");
  made.robots = await readValue(session, `ns=2;s=Fleet.Scenarios.Runs.${runId}.Robots`);
  made.states = await readValue(session, `ns=2;s=Fleet.Scenarios.Runs.${runId}.States`);
  await watching.end();
});
