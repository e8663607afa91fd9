PRAGMA journal_mode=WAL;
BEGIN TRANSACTION;
CREATE TABLE executions (
    number INTEGER PRIMARY KEY AUTOINCREMENT, execution_id BLOB NOT NULL UNIQUE,
    requestor_id TEXT NOT NULL, space INTEGER NOT NULL, 
    publisher_id INTEGER NOT NULL, writer_group_id INTEGER NOT NULL, data_set_writer_id INTEGER NOT NULL,
    action_target_id INTEGER NOT NULL, content BLOB NOT NULL, issued INTEGER NOT NULL, timeout_ms INTEGER NOT NULL,

    state INTEGER NOT NULL, status INTEGER NOT NULL, message TEXT NOT NULL, result BLOB NOT NULL) STRICT;
INSERT INTO "executions" VALUES(2,X'0000000000000000000000000000000C','0.server',0,0,2,1700,1,X'0B',133000000000000012,9000,2,0,'taken by anna',X'');
INSERT INTO "executions" VALUES(3,X'0000000000000000000000000000000D','0.server',0,0,2,1700,1,X'0B',133000000000000013,9000,3,1073741824,'half of it: ½',X'0B0001');
CREATE TABLE forgotten (space INTEGER PRIMARY KEY, issued INTEGER NOT NULL) STRICT;
INSERT INTO "forgotten" VALUES(0,133000000000000011);
CREATE TABLE request_versions (
    execution_id BLOB PRIMARY KEY, version INTEGER NOT NULL) STRICT;
CREATE TABLE requests (
    number INTEGER PRIMARY KEY, execution_id BLOB NOT NULL UNIQUE, 
    publisher_id INTEGER NOT NULL, writer_group_id INTEGER NOT NULL, data_set_writer_id INTEGER NOT NULL,
    action_target_id INTEGER NOT NULL, content BLOB NOT NULL, issued INTEGER NOT NULL, timeout_ms INTEGER NOT NULL,

    outcome TEXT, state INTEGER, status INTEGER, message TEXT, result BLOB) STRICT;
DELETE FROM "sqlite_sequence";
INSERT INTO "sqlite_sequence" VALUES('executions',3);
COMMIT;
PRAGMA application_id=1969317482;
PRAGMA user_version=1;
