-- The journal of the first version, with one run and one reading.
PRAGMA journal_mode = WAL;
CREATE TABLE runs (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    started TEXT NOT NULL,
    ended TEXT,
    method TEXT NOT NULL,
    machine TEXT NOT NULL,
    state TEXT NOT NULL
        CHECK (state IN ('running', 'held', 'finished', 'failed', 'interrupted')),
    program_version TEXT NOT NULL,
    config TEXT NOT NULL,
    config_sha256 TEXT NOT NULL,
    plan_head TEXT NOT NULL,
    plan_sha256 TEXT NOT NULL
) STRICT;
CREATE TABLE steps (
    run INTEGER NOT NULL REFERENCES runs (id),
    id INTEGER NOT NULL,
    step TEXT NOT NULL,
    PRIMARY KEY (run, id)
) STRICT;
CREATE TABLE stages (
    seq INTEGER PRIMARY KEY,
    run INTEGER NOT NULL REFERENCES runs (id),
    stage TEXT NOT NULL
) STRICT;
CREATE TABLE readings (
    seq INTEGER PRIMARY KEY,
    run INTEGER NOT NULL REFERENCES runs (id),
    step INTEGER NOT NULL,
    repeat INTEGER NOT NULL,
    x_mm REAL, y_mm REAL, z_mm REAL, a_rad REAL, b_rad REAL, c_rad REAL, s_rad REAL,
    value_mm REAL,
    sensor TEXT NOT NULL,
    t_s REAL NOT NULL,
    flag TEXT NOT NULL,
    temperatures_c TEXT NOT NULL
) STRICT;
CREATE TABLE events (
    seq INTEGER PRIMARY KEY,
    run INTEGER NOT NULL REFERENCES runs (id),
    at TEXT NOT NULL,
    event TEXT NOT NULL
) STRICT;
CREATE TABLE estimates (
    seq INTEGER PRIMARY KEY,
    run INTEGER NOT NULL REFERENCES runs (id),
    made TEXT NOT NULL,
    estimate TEXT NOT NULL,
    sha256 TEXT NOT NULL,
    program_version TEXT NOT NULL
) STRICT;
CREATE INDEX stages_of ON stages (run);
CREATE INDEX readings_of ON readings (run);
CREATE INDEX events_of ON events (run);
CREATE INDEX estimates_of ON estimates (run);

PRAGMA user_version = 1;
INSERT INTO runs VALUES (4, '2026-09-01T08:00:00Z', NULL, 'self-calibration', 'mill', 'held', '0.1.0',
    '', '', '{"trued_plan":1,"method":"self-calibration","settings":{"n":8},"machine":{"name":"mill","topology":"w-C-B-X-F-Z-Y-S-t"},"probe":{"ball_radius_mm":3.0},"artefact":{"kind":"cylinder","centre_mm":[0.3,0.1,50.0],"axis":[0.0,0.0,1.0],"radius_mm":45.0}}', '');
INSERT INTO readings VALUES (1, 4, 0, 0, 48.0, 0.0, 50.0, NULL, 0.0, 0.0, NULL, NULL, 'probe', 3.5,
    '', '{}');
