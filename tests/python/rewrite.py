"""A recording as pandas, polars, DuckDB and pyarrow write it.

usage: rewrite.py RECORDING.parquet FOLDER    prints the files that it made
"""

import pathlib
import sys

import duckdb
import pandas
import polars
import pyarrow.parquet as pq

source, folder = sys.argv[1], pathlib.Path(sys.argv[2])
made = []


def out(name, suffix="parquet"):
    made.append(folder / f"{name}.{suffix}")
    return made[-1]


frame = pandas.read_parquet(source)
frame.to_parquet(out("pandas"))
for codec in ("snappy", "gzip", "brotli", "lz4", "zstd", None):
    frame.to_parquet(out(f"pandas-{codec}"), compression=codec)

lazy = polars.read_parquet(source)
lazy.write_parquet(out("polars"))
for codec in ("snappy", "gzip", "brotli", "lz4", "zstd", "uncompressed"):
    lazy.write_parquet(out(f"polars-{codec}"), compression=codec)

relation = f"(FROM read_parquet('{source}'))"
duckdb.sql(f"COPY {relation} TO '{out('duckdb')}' (FORMAT parquet)")
for codec in ("snappy", "gzip", "brotli", "lz4_raw", "zstd", "uncompressed"):
    duckdb.sql(f"COPY {relation} TO '{out('duckdb-' + codec)}' (FORMAT parquet, COMPRESSION {codec})")
duckdb.sql(f"COPY {relation} TO '{out('duckdb-v2')}' (FORMAT parquet, PARQUET_VERSION v2)")

table = pq.read_table(source)
floats = [f.name for f in table.schema if str(f.type) in ("double", "float")]
whole = [f.name for f in table.schema if f.name not in floats]
pq.write_table(table, out("pyarrow"))
pq.write_table(table, out("pyarrow-v2"), data_page_version="2.0", compression="gzip")
pq.write_table(table, out("pyarrow-1.0"), version="1.0")
pq.write_table(table, out("pyarrow-plain"), use_dictionary=False, row_group_size=700, data_page_size=512)
split = dict.fromkeys(floats, "BYTE_STREAM_SPLIT") | dict.fromkeys(whole, "DELTA_BINARY_PACKED")
pq.write_table(table, out("pyarrow-split"), use_dictionary=False, column_encoding=split)
bare = table.replace_schema_metadata(None)
pq.write_table(bare, out("pyarrow-bare"), store_schema=False)

frame.to_feather(out("pandas-lz4", "feather"))
frame.to_feather(out("pandas-zstd", "feather"), compression="zstd")
lazy.write_ipc(out("polars", "arrow"))
lazy.write_ipc(out("polars-zstd", "arrow"), compression="zstd")
lazy.write_ipc_stream(out("polars-stream", "arrows"))

# with a clock of a calendar in place of a time
moments = pandas.to_datetime("2026-11-22T10:00:00Z") + pandas.to_timedelta(frame["t_ns"], unit="ns")
clock = frame.drop(columns=["t_ns", "run", "fsj", "zeta", "rest_angle_rad"]).assign(time=moments)
clock.to_parquet(out("clock-pandas"))
polars.from_pandas(clock).write_ipc(out("clock-polars", "arrow"))
clock.to_csv(out("clock-pandas", "csv"), index=False)
clock.set_index("time").to_parquet(out("clock-index"))
polars.from_pandas(clock).with_columns(polars.col("time").dt.time()).write_parquet(out("clock-of-day"))
clock.assign(time=pandas.to_timedelta(frame["t_ns"], unit="ns")).to_parquet(out("clock-duration"))

print("\n".join(str(m) for m in made))
