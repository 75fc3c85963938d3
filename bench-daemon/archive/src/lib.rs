//! Store and forward: finished runs to an object store, and their rows as Parquet.
