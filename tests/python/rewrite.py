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


def out(name):
    made.append(folder / f"{name}.parquet")
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

print("\n".join(str(m) for m in made))
