//! Tables of a catalogue, and the version that a file states.

/// Mark of a catalogue in the head of an SQLite file: `EISC`.
pub(crate) const APPLICATION: i32 = 0x4549_5343;
/// Version of the tables. A reader refuses a newer one; a scan builds an older one again.
pub const VERSION: i32 = 6;

/// Tables and indexes. `run_key` finds runs by the name, a serial number or the batch of a cell,
/// `run_text` by words; both repeat the columns that queries filter by, so that no other table is
/// read for an unwanted run. Text that many runs share is stored in `phrase` once, so that a word
/// search reads little text. `cell` is built from `run_cell` at the end of a scan. Row numbers are
/// never part of a reply.
pub(crate) const TABLES: &str = "
CREATE TABLE root (folder TEXT PRIMARY KEY) WITHOUT ROWID;
CREATE TABLE run (
  run TEXT PRIMARY KEY, folder TEXT NOT NULL, name TEXT NOT NULL, stamp TEXT NOT NULL,
  missing INTEGER NOT NULL, version TEXT NOT NULL, experiment TEXT NOT NULL, bench TEXT NOT NULL,
  operator TEXT, seed TEXT NOT NULL, time TEXT NOT NULL, simulated INTEGER NOT NULL,
  started_unix_s REAL NOT NULL, time_source TEXT NOT NULL, bench_time_s REAL NOT NULL, how TEXT,
  verdict TEXT NOT NULL, trip TEXT, resumed INTEGER NOT NULL, spectra INTEGER NOT NULL,
  refused_points INTEGER NOT NULL, fits INTEGER NOT NULL, config_sha256 TEXT, content_sha256 TEXT,
  damage TEXT NOT NULL, cells TEXT NOT NULL, instruments TEXT NOT NULL, tags TEXT NOT NULL,
  notes INTEGER NOT NULL, map TEXT NOT NULL
);
CREATE INDEX run_started ON run (started_unix_s, run);
CREATE INDEX run_bench ON run (bench, started_unix_s, run);
CREATE INDEX run_verdict ON run (verdict, started_unix_s, run);
CREATE INDEX run_bench_verdict ON run (bench, verdict, started_unix_s, run);
CREATE INDEX run_experiment ON run (experiment, started_unix_s, run);
CREATE INDEX run_name ON run (name);
CREATE INDEX run_folder ON run (folder);
CREATE INDEX run_map ON run (run) WHERE map <> 'null';
CREATE TABLE run_key (
  kind INTEGER NOT NULL, key TEXT NOT NULL, started_unix_s REAL NOT NULL, run TEXT NOT NULL,
  bench TEXT NOT NULL, verdict TEXT NOT NULL, PRIMARY KEY (kind, key, started_unix_s, run)
) WITHOUT ROWID;
CREATE TABLE run_text (
  started_unix_s REAL NOT NULL, run TEXT NOT NULL, bench TEXT NOT NULL, verdict TEXT NOT NULL,
  name TEXT NOT NULL, phrase INTEGER NOT NULL, PRIMARY KEY (started_unix_s, run)
) WITHOUT ROWID;
CREATE TABLE phrase (phrase INTEGER PRIMARY KEY, text TEXT NOT NULL UNIQUE);
CREATE TABLE run_cell (
  name TEXT NOT NULL, serial TEXT NOT NULL, started_unix_s REAL NOT NULL, run TEXT NOT NULL,
  scanned_serial TEXT, model TEXT, batch TEXT, barcode TEXT, maker TEXT, chemistry TEXT, term TEXT,
  bench TEXT NOT NULL, experiment TEXT NOT NULL, verdict TEXT NOT NULL,
  PRIMARY KEY (name, serial, started_unix_s, run)
) WITHOUT ROWID;
CREATE INDEX run_cell_run ON run_cell (run);
CREATE TABLE cell (
  name TEXT NOT NULL, serial TEXT NOT NULL, runs INTEGER NOT NULL, first_unix_s REAL NOT NULL,
  last_unix_s REAL NOT NULL, model TEXT, batch TEXT, barcode TEXT, maker TEXT, chemistry TEXT,
  term TEXT, PRIMARY KEY (name, serial)
) WITHOUT ROWID;
CREATE TABLE spectrum (
  run TEXT NOT NULL, file TEXT NOT NULL, name TEXT NOT NULL, bench TEXT NOT NULL,
  cell TEXT NOT NULL, serial TEXT, batch TEXT, chemistry TEXT, fixture TEXT NOT NULL,
  corrected INTEGER NOT NULL, repeat INTEGER NOT NULL,
  started_unix_s REAL NOT NULL, time_source TEXT NOT NULL, amplitude_a REAL NOT NULL,
  bias_a REAL NOT NULL, ocv_v REAL,
  temperature_c REAL, points INTEGER NOT NULL, refused_points INTEGER NOT NULL, low_hz REAL,
  high_hz REAL, r_high_ohm REAL, r_high_hz REAL, r_high_sigma_ohm REAL, r_low_ohm REAL,
  r_low_sigma_ohm REAL,
  PRIMARY KEY (run, file)
) WITHOUT ROWID;
CREATE INDEX spectrum_started ON spectrum (started_unix_s, run, file);
CREATE INDEX spectrum_cell ON spectrum (cell, started_unix_s, run, file);
CREATE INDEX spectrum_bench ON spectrum (bench, started_unix_s, run, file);
CREATE TABLE fit (
  run TEXT NOT NULL, file TEXT NOT NULL, name TEXT NOT NULL, bench TEXT NOT NULL,
  cell TEXT NOT NULL, serial TEXT, batch TEXT, cells INTEGER NOT NULL, rc INTEGER NOT NULL,
  started_unix_s REAL NOT NULL, time_source TEXT NOT NULL, temperature_c REAL, ocv_v REAL, r_ohm REAL NOT NULL,
  r_sigma_ohm REAL, dc_resistance_ohm REAL NOT NULL, dc_resistance_sigma_ohm REAL, slow_r_ohm REAL,
  slow_r_sigma_ohm REAL, slow_tau_s REAL, slow_tau_sigma_s REAL, time_constants_s TEXT NOT NULL,
  rms_ohm REAL NOT NULL, reduced_chi2 REAL, points INTEGER NOT NULL, PRIMARY KEY (run, file)
) WITHOUT ROWID;
CREATE INDEX fit_started ON fit (started_unix_s, run, file);
CREATE INDEX fit_cell ON fit (cell, started_unix_s, run, file);
CREATE INDEX fit_pooled ON fit (cells) WHERE cells > 1;
CREATE TABLE event (
  run TEXT NOT NULL, line INTEGER NOT NULL, time_s REAL NOT NULL, kind TEXT NOT NULL,
  text TEXT NOT NULL, by TEXT, PRIMARY KEY (run, line)
) WITHOUT ROWID;
CREATE INDEX event_trip ON event (run) WHERE kind = 'trip';
CREATE TABLE diagnosis (
  folder TEXT PRIMARY KEY, name TEXT NOT NULL, stamp TEXT NOT NULL, run TEXT, data_set TEXT NOT NULL,
  model TEXT NOT NULL, verdict TEXT NOT NULL, summary TEXT NOT NULL, parameters TEXT NOT NULL,
  damage TEXT
) WITHOUT ROWID;
CREATE INDEX diagnosis_run ON diagnosis (run);
";
