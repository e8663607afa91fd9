PRAGMA journal_mode=WAL;
BEGIN TRANSACTION;
CREATE TABLE robots (
    name TEXT PRIMARY KEY, origin TEXT NOT NULL, bridge TEXT NOT NULL, definition TEXT NOT NULL,
    registered_by TEXT NOT NULL, registered_s REAL NOT NULL) STRICT;
INSERT INTO "robots" VALUES('cart','registered','cell','{"skills": {"go": {"id": 1500}}}','anna',5.5);
INSERT INTO "robots" VALUES('arm','announced','300','{}','ua_300_2_1600',7.25);
COMMIT;
PRAGMA application_id=1969317482;
PRAGMA user_version=1;
