PRAGMA journal_mode=WAL;
BEGIN TRANSACTION;
CREATE TABLE facts (number INTEGER PRIMARY KEY AUTOINCREMENT, run_id TEXT NOT NULL, line TEXT NOT NULL) STRICT;
INSERT INTO "facts" VALUES(2,'r1','{"fact": "RunCreated", "at": 2.0, "run_id": "r1", "text": "version: 1\nname: x\nsteps: []", "parameters": {"speed": 0.5}, "by": "anna"}');
INSERT INTO "facts" VALUES(3,'r2','{"fact": "RunCreated", "at": 3.0, "run_id": "r2", "text": "version: 1\nname: x\nsteps: []", "parameters": {"speed": 0.5}, "by": "anna"}');
INSERT INTO "facts" VALUES(5,'r1','{"fact": "StepStarted", "at": 5.0, "step": "0"}');
INSERT INTO "facts" VALUES(6,'r1','{"fact": "TaskAssigned", "at": 5.0, "step": "0", "task": "a", "attempt": 1, "robot": "cart", "execution_id": "00000000000000000000000000000003", "skill": "go", "arguments": {"to": 1.5}}');
INSERT INTO "facts" VALUES(7,'r1','{"fact": "TaskAccepted", "at": 6.0, "step": "0", "attempt": 1}');
INSERT INTO "facts" VALUES(8,'r2','{"fact": "RunEnded", "at": 6.5, "outcome": "failed", "reason": "it does not fit"}');
CREATE TABLE fault_capacities (robot TEXT NOT NULL, source TEXT NOT NULL,
    capacities TEXT NOT NULL, PRIMARY KEY (robot, source)) STRICT;
INSERT INTO "fault_capacities" VALUES('arm','grip','grab weld');
CREATE TABLE faults (robot TEXT NOT NULL, source TEXT NOT NULL, reason TEXT NOT NULL, active INTEGER NOT NULL,
    acknowledged INTEGER NOT NULL, since REAL NOT NULL, acknowledged_by TEXT NOT NULL, PRIMARY KEY (robot, source))
    STRICT;
INSERT INTO "faults" VALUES('cart','silent','nothing is heard',1,0,7.0,'');
INSERT INTO "faults" VALUES('arm','grip','it is broken',1,1,8.0,'otto');
CREATE TABLE halt_reasons (execution_id TEXT PRIMARY KEY, why TEXT NOT NULL)
    STRICT;
INSERT INTO "halt_reasons" VALUES('00000000000000000000000000000009','a fault');
CREATE TABLE halts (execution_id TEXT PRIMARY KEY, robot TEXT NOT NULL,
    skill TEXT NOT NULL, since REAL NOT NULL) STRICT;
INSERT INTO "halts" VALUES('00000000000000000000000000000009','arm','grab',9.0);
CREATE TABLE holds (robot TEXT PRIMARY KEY, held_by TEXT NOT NULL, since REAL NOT NULL,
    reason TEXT NOT NULL) STRICT;
INSERT INTO "holds" VALUES('arm','anna',10.0,'a visit');
CREATE TABLE runs (
    number INTEGER PRIMARY KEY AUTOINCREMENT, run_id TEXT NOT NULL UNIQUE, ended INTEGER NOT NULL) STRICT;
INSERT INTO "runs" VALUES(2,'r1',0);
INSERT INTO "runs" VALUES(3,'r2',1);
CREATE TABLE settings (name TEXT PRIMARY KEY, value TEXT NOT NULL,
    instead_of TEXT NOT NULL, set_by TEXT NOT NULL, set_at REAL NOT NULL) STRICT;
INSERT INTO "settings" VALUES('mode','{"mode": "operator"}','{}','otto',11.0);
INSERT INTO "settings" VALUES('decision r1.0','[]','','otto',12.0);
CREATE INDEX facts_of_run ON facts (run_id, number);
DELETE FROM "sqlite_sequence";
INSERT INTO "sqlite_sequence" VALUES('runs',8);
INSERT INTO "sqlite_sequence" VALUES('facts',8);
COMMIT;
PRAGMA application_id=1969317482;
PRAGMA user_version=1;
