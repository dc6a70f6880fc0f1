PRAGMA application_id = 1902405490;
PRAGMA user_version = 2;
PRAGMA page_size = 4096;
PRAGMA journal_mode = wal;
CREATE TABLE meta (name TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT, WITHOUT ROWID;
CREATE TABLE turns (
    epoch INTEGER PRIMARY KEY, -- a coordinator's turn at the run
    opened REAL NOT NULL,      -- when it opened the run [s since 1970]
    last REAL NOT NULL         -- the last commit of its rows
) STRICT;
CREATE TABLE blocks (
    first INTEGER PRIMARY KEY, -- number of the block's first row
    n INTEGER NOT NULL,
    epoch INTEGER NOT NULL,
    cpu_seconds REAL NOT NULL, -- what the rows cost on their workers
    crc INTEGER NOT NULL,      -- crc32 of the blob
    rows BLOB NOT NULL         -- rows of the dtype of rows.RowShape: their first bytes, their second bytes,
                               -- and so on, deflated (zlib)
) STRICT;
CREATE TABLE errors (row INTEGER PRIMARY KEY, reason TEXT NOT NULL) STRICT;
CREATE TABLE makers (
    first INTEGER PRIMARY KEY, -- number of the first of some rows that one worker made
    n INTEGER NOT NULL,
    worker TEXT NOT NULL,      -- its id, new at every start
    host TEXT NOT NULL
) STRICT;
CREATE TABLE withdrawn ( -- blocks, as they were, of which rows were taken back: their maker was found wrong
    first INTEGER, n INTEGER, epoch INTEGER, cpu_seconds REAL, crc INTEGER, rows BLOB
) STRICT;
-- meta: created
-- meta: package
-- meta: run
-- meta: scene
-- meta: shape
-- meta: spec
