"""Reads a fleet dataset with public libraries and checks that all of them see the same.

    pip install numpy polars pandas pyarrow duckdb      each but numpy may be missing and is then skipped
    python read_fleet.py DATASET [--expect JSON|FILE] [--require polars,pandas,pyarrow,duckdb]

Of every table: row count, names and types of columns, nulls, sums and checksums, alike in all libraries
and equal to what is expected; columns out of folder names (`sequence`, `actuator`) arrive as text, without
options, and fit to the features table; a filter leaves out files and row groups; the folders hold what
they may hold. Prints a JSON summary, and a line `FAIL ...` on stderr for each failure.

Expected: {"tables": {"features": {"rows": N, "runs": N, "types": {column: type}, "nulls": {column: N},
"sums": {column: x}, "checksums": {column: hex}}, ...}}; everything may be left out. Types: u64 i64 f64 f32
bool text. A sum is over the values that are not null, in double precision; it may differ by 1e-9 of the sum
of magnitudes. Checksum: rows sorted by the table's key (KEYS), sum over rows k = 0, 1, ... of
bits * (2 k + 1) modulo 2^64, 16 hexadecimal digits. The bits of a float are its own (f32: 32 bits), of an
integer its two's complement, of a text FNV-1a (64 bits) of its UTF-8, of a null 2^64 - 1.

Exit code: 0 all alike, 1 otherwise.
"""

import argparse
import importlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path

LIBRARIES = ("polars", "pandas", "pyarrow", "duckdb")
REQUIRED = ("features", "actuators")
OPTIONAL = ("telemetry", "maps", "diagnoses")
KEYS = {
    "features": ["run"],
    "actuators": ["actuator"],
    "telemetry": ["run", "t_ns"],
    "maps": ["actuator", "sequence", "rest_angle_rad", "feature", "zeta", "fsj"],
    "diagnoses": ["run", "maps"],
}
HIVE = ("sequence", "actuator")


def spec(**groups):
    return {name: kind for kind, names in groups.items() for name in names.split()}


WITNESSES = "sine_travel_rad current_sum_a current_imbalance even_current_a bias_current_a"
TYPES = {
    "features": spec(u64="run", text="actuator tail position sequence kind", f64=(
        "fsj zeta rest_angle_rad p1_rad_per_s p3 speed_loss_rad_per_s mean_speed_rad_per_s ripple_rad_per_s p2_a p3_rad rise_s "
        f"current_rms_a {WITNESSES} mean_speed_sd_rad_per_s ripple_sd_rad_per_s p2_sd_a p3_sd_rad rise_sd_s current_rms_sd_a "
        "sine_travel_sd_rad current_sum_sd_a current_imbalance_sd even_current_sd_a bias_current_sd_a")),
    "actuators": spec(text="actuator tail position parameters", f64=(
        "supply_voltage_v phase_resistance_ohm phase_inductance_h back_emf_v_s_per_rad inertia_kg_m2 viscous_n_m_s_per_rad "
        "torque_limit_n_m static_friction_n_m dynamic_friction_ratio gear_ratio backlash_half_width_rad end_stop_rad "
        "opposing_efficiency aiding_efficiency position_gain_per_s speed_reference_limit_rad_per_s "
        "speed_proportional_n_m_s_per_rad speed_integral_n_m_per_rad integrator_limit_n_m current_limit_a "
        "hysteresis_half_band_a temperature_degc")),
    "telemetry": spec(u64="run", i64="t_ns", f64="fsj zeta rest_angle_rad", text="sequence actuator"),
    "maps": spec(text="actuator tail position sequence feature", f64="rest_angle_rad fsj zeta value raw_value"),
    "diagnoses": spec(u64="run", text="actuator tail position sequence outcome contradicting reason maps", f64=(
        "fsj zeta fsj_lo fsj_hi fsj_estimate zeta_lo zeta_hi zeta_estimate area coverage")),
}
NULLABLE = {"features": {c for c in TYPES["features"] if TYPES["features"][c] == "f64"} - {"fsj", "zeta", "rest_angle_rad"},
            "diagnoses": {"fsj_lo", "fsj_hi", "fsj_estimate", "zeta_lo", "zeta_hi", "zeta_estimate", "area", "coverage"},
            "telemetry": None}   # telemetry: channels and fault pairs may be null in a measured run
failures, notes = [], []


def fail(text):
    failures.append(text)
    print(f"FAIL {text}", file=sys.stderr)


def short(error):
    return f"{type(error).__name__}: {str(error).strip().splitlines()[0][:300] if str(error).strip() else ''}"


# ---------------------------------------------------------------- one table as each library sees it
# A reader gives (types, columns): types {name: kind}, columns {name: (values, null)} as numpy arrays;
# text comes as numpy objects.


def kind_of(name):
    """The kind behind a library's name of a type, or that name itself."""
    n = str(name).lower()
    if n in ("ubigint", "uint64"):
        return "u64"
    if n in ("bigint", "int64"):
        return "i64"
    if n in ("double", "float64"):
        return "f64"
    if n in ("float", "float32", "real"):
        return "f32"
    if n in ("boolean", "bool"):
        return "bool"
    if n in ("varchar", "string", "str", "utf8", "large_string", "string_view", "categorical", "object"):
        return "text"
    return str(name)


def with_polars(folder, hive):
    import numpy as np
    import polars as pl
    # **/*.parquet would do as well; on the folder itself, files of another name are an error
    scan = pl.scan_parquet(folder, hive_partitioning=True) if hive else pl.scan_parquet(folder)
    types = {n: kind_of(t) for n, t in scan.collect_schema().items()}
    if hive and any(types.get(c) != "text" for c in HIVE):   # said by the caller; the rest is still to be compared
        scan = pl.scan_parquet(folder, hive_schema={c: pl.String for c in HIVE})
    frame = scan.collect()
    columns = {}
    for s in frame:
        null = s.is_null().to_numpy()
        if kind_of(s.dtype) == "text":
            values = np.array(s.cast(pl.String).fill_null("").to_list(), dtype=object)
        else:
            if s.dtype.is_float() and s.is_nan().any():
                fail(f"{Path(folder).name}.{s.name}: NaN in the file (polars)")
            values = s.fill_null(0).to_numpy()
        columns[s.name] = (values, null)
    return types, columns


def with_pandas(folder, hive):
    import numpy as np
    import pandas as pd
    frame = pd.read_parquet(folder)      # no options
    types, columns = {}, {}
    for name in frame.columns:
        s = frame[name]
        dtype = s.cat.categories.dtype if isinstance(s.dtype, pd.CategoricalDtype) else s.dtype
        types[name] = kind_of(dtype)
        null = s.isna().to_numpy()
        values = s.astype(object).to_numpy() if types[name] == "text" or isinstance(s.dtype, pd.CategoricalDtype) else s.to_numpy()
        columns[name] = (np.where(null, "", values) if types[name] == "text" else np.where(null, 0, values).astype(values.dtype), null)
    return types, columns


def sql_text(text):
    return "'" + str(text).replace("'", "''") + "'"


def duckdb_table(folder, hive):
    files = sql_text(f"{folder}/**/*.parquet")
    return f"read_parquet({files}, hive_partitioning = true)" if hive else f"read_parquet({files}, hive_partitioning = false)"


def with_duckdb(folder, hive):
    import duckdb
    import numpy as np
    connection = duckdb.connect()
    table = duckdb_table(folder, hive)
    types = {row[0]: kind_of(row[1]) for row in connection.execute(f"DESCRIBE SELECT * FROM {table}").fetchall()}
    if hive and any(types.get(c) != "text" for c in HIVE):
        table = table.replace("hive_partitioning = true", "hive_partitioning = true, hive_types_autocast = false")
    floats = [n for n, t in types.items() if t in ("f64", "f32")]
    if floats:
        nan = connection.execute("SELECT " + ", ".join(f'count(*) FILTER (isnan("{n}"))' for n in floats) + f" FROM {table}").fetchall()[0]
        for name, n in zip(floats, nan):
            if n:
                fail(f"{Path(folder).name}.{name}: NaN in the file (DuckDB)")
    columns = {}
    for name, values in connection.execute(f"SELECT * FROM {table}").fetchnumpy().items():
        null = np.ma.getmaskarray(values).copy()
        values = np.ma.getdata(values)
        if values.dtype == object:
            null |= np.array([v is None for v in values], dtype=bool)
            values = np.where(null, "", values)
        columns[name] = (values, null)
    return types, columns


READERS = {"polars": with_polars, "pandas": with_pandas, "duckdb": with_duckdb}


# ---------------------------------------------------------------- numbers of a table


def fnv1a(text):
    h = 0xCBF29CE484222325
    for byte in text.encode():
        h = (h ^ byte) * 0x100000001B3 & 0xFFFFFFFFFFFFFFFF
    return h


def codes_of(values):
    """Texts as numbers in the order of the texts, and the texts."""
    import numpy as np
    seen = {}
    raw = np.fromiter((seen.setdefault(str(v), len(seen)) for v in values), dtype=np.int64, count=len(values))
    texts = sorted(seen)
    rank = np.empty(len(texts), dtype=np.int64)
    for place, text in enumerate(texts):
        rank[seen[text]] = place
    return (rank[raw] if len(raw) else raw), texts


def bits_of(values, null):
    import numpy as np
    if values.dtype == object:
        codes, texts = codes_of(values)
        bits = np.array([fnv1a(t) for t in texts] or [0], dtype=np.uint64)[codes]
    elif values.dtype.kind == "f":
        bits = np.ascontiguousarray(values).view(np.uint32 if values.dtype.itemsize == 4 else np.uint64).astype(np.uint64)
    else:
        bits = values.astype(np.int64).view(np.uint64) if values.dtype.kind == "i" else values.astype(np.uint64)
    return np.where(null, np.uint64(0xFFFFFFFFFFFFFFFF), bits)


def numbers_of(table, types, columns):
    import numpy as np
    rows = len(next(iter(columns.values()))[0]) if columns else 0
    keys = [columns[k][0] for k in KEYS[table] if k in columns]
    keys = [codes_of(k)[0] if k.dtype == object else k for k in keys]
    order = np.lexsort(keys[::-1]) if keys else np.arange(rows)
    weights = np.arange(rows, dtype=np.uint64) * np.uint64(2) + np.uint64(1)
    result = {"rows": rows, "columns": {}}
    if "run" in columns:
        result["runs"] = int(len(np.unique(columns["run"][0])))
    for name, (values, null) in columns.items():
        bits = bits_of(values, null)[order]
        entry = {"type": types[name], "nulls": int(null.sum()), "checksum": f"{int((bits * weights).sum(dtype=np.uint64)):016x}"}
        if values.dtype.kind in "fiu":
            present = values[order].astype(np.float64)[~null[order]]
            entry["sum"], entry["magnitude"] = float(present.sum()), float(np.abs(present).sum())
        result["columns"][name] = entry
    return result


def close(a, b, magnitude):
    return abs(a - b) <= 1e-9 * max(magnitude, abs(b), 1e-300)


def compare_libraries(table, found):
    first = next(iter(found))
    for other in list(found)[1:]:
        a, b = found[first], found[other]
        if a["rows"] != b["rows"]:
            fail(f"{table}: {a['rows']} rows with {first}, {b['rows']} with {other}")
        if set(a["columns"]) != set(b["columns"]):
            fail(f"{table}: columns differ between {first} and {other}: {sorted(set(a['columns']) ^ set(b['columns']))}")
        for name in a["columns"]:
            for key in ("type", "nulls", "checksum"):
                x, y = a["columns"][name][key], b["columns"].get(name, {}).get(key)
                if y is not None and x != y:
                    fail(f"{table}.{name}: {key} {x} with {first}, {y} with {other}")


def compare_expected(table, library, got, want):
    for key in ("rows", "runs"):
        if key in want and got.get(key) != want[key]:
            fail(f"{table}: {library} has {got.get(key)} {key}, expected {want[key]}")
    for key, entry in (("types", "type"), ("nulls", "nulls"), ("sums", "sum"), ("checksums", "checksum")):
        for name, value in want.get(key, {}).items():
            column = got["columns"].get(name)
            if column is None:
                fail(f"{table}.{name}: expected, but {library} does not see it")
            elif key == "sums":
                if not close(column.get("sum", float("nan")), value, column.get("magnitude", 0.0)):
                    fail(f"{table}.{name}: sum {column.get('sum')} with {library}, expected {value}")
            elif column[entry] != value:
                fail(f"{table}.{name}: {entry} {column[entry]} with {library}, expected {value}")


def compare_spec(table, library, got):
    """Names, types and nulls against the specification; further columns are allowed."""
    for name, kind in TYPES[table].items():
        column = got["columns"].get(name)
        if column is None:
            fail(f"{table}.{name}: missing with {library}")
        elif column["type"] != kind:
            hint = ""
            if table == "telemetry" and name in HIVE:
                hint = ": guessed from the folder's name; ids and names must not look like numbers or dates"
            fail(f"{table}.{name}: type {column['type']} with {library}, should be {kind}{hint}")
        elif column["nulls"] and NULLABLE.get(table, set()) is not None and name not in NULLABLE.get(table, set()):
            fail(f"{table}.{name}: {column['nulls']} nulls with {library}")
    if table == "telemetry":
        for name, column in got["columns"].items():
            if name not in TYPES[table] and column["type"] not in ("f32", "f64"):
                fail(f"telemetry.{name}: type {column['type']} with {library}, should be f32 or f64")


def compare_runs(library, features, telemetry):
    """Actuator and sequence of every run of the telemetry, from the folders, against the features."""
    import numpy as np
    def owners(columns):
        runs, first = np.unique(columns["run"][0], return_index=True)
        return {int(r): (str(columns["actuator"][0][i]), str(columns["sequence"][0][i])) for r, i in zip(runs, first)}
    known = owners(features)
    for run, who in owners(telemetry).items():
        if known.get(run) != who:
            fail(f"telemetry: run {run} is of {who} with {library}, in the features of {known.get(run)}")
            return


def pairs_of(columns):
    """Pairs of sequence and actuator, and the pair's number in every row."""
    import numpy as np
    (s, sequences), (a, actuators) = (codes_of(columns[c][0]) for c in HIVE)
    both, at = np.unique(s * len(actuators) + a, return_inverse=True)
    return [(sequences[n // len(actuators)], actuators[n % len(actuators)]) for n in both.tolist()], at


# ---------------------------------------------------------------- what a filter leaves out


def folder_pairs(telemetry):
    pairs = []
    for path in sorted(telemetry.glob("sequence=*/actuator=*")):
        pairs.append((path.parent.name.split("=", 1)[1], path.name.split("=", 1)[1]))
    return pairs


def prune_polars(telemetry, actuator, run, total):
    """Files that the plan names, and row groups that the reader says it reads (by its verbose output)."""
    import polars as pl
    schema = {c: pl.String for c in HIVE}
    scan = pl.scan_parquet(f"{telemetry}/**/*.parquet", hive_partitioning=True, hive_schema=schema)
    result = {}
    named = re.search(r"Parquet SCAN \[(.*?)\]", scan.filter(pl.col("actuator") == actuator).explain(), re.DOTALL)
    if named:
        more = re.search(r"(\d+) other", named[1])
        result["files"] = [named[1].count(".parquet") + (int(more[1]) if more else 0), total]
    code = ("import sys, polars as pl; s = {c: pl.String for c in ('sequence', 'actuator')}; "
            "print(len(pl.scan_parquet(sys.argv[1], hive_partitioning=True, hive_schema=s)"
            ".filter(pl.col('actuator') == sys.argv[2], pl.col('run') == int(sys.argv[3])).collect()))")
    done = subprocess.run([sys.executable, "-c", code, f"{telemetry}/**/*.parquet", actuator, str(run)],
                          env={**os.environ, "POLARS_VERBOSE": "1"}, capture_output=True, text=True)
    groups = re.search(r"reading (\d+) / (\d+) row groups", done.stderr)
    if groups:
        result["row_groups"] = [int(groups[1]), int(groups[2])]
    if files := re.search(r"skipping (\d+) / (\d+) files", done.stderr):
        result["files"] = [int(files[2]) - int(files[1]), int(files[2])]
    return result


def prune_pyarrow(telemetry, actuator, run, total):
    import pyarrow as pa
    import pyarrow.dataset as ds
    hive = ds.partitioning(pa.schema([(c, pa.string()) for c in HIVE]), flavor="hive")
    data = ds.dataset(telemetry, partitioning=hive)
    kept = list(data.get_fragments(filter=ds.field("actuator") == actuator))
    groups = sum(len(f.split_by_row_group(filter=ds.field("run") == run)) for f in kept)
    return {"files": [len(kept), len(list(data.get_fragments()))], "row_groups": [groups, sum(f.num_row_groups for f in kept)]}


def prune_duckdb(telemetry, actuator, run, total):
    import duckdb
    table = duckdb_table(telemetry, True).replace("= true", "= true, hive_types_autocast = false")
    query = f"SELECT sum(t_ns) FROM {table} WHERE actuator = {sql_text(actuator)} AND run = {run}"
    text = duckdb.connect().execute(f"EXPLAIN ANALYZE {query}").fetchall()[0][1]
    text = re.sub(r"[│\s]+", " ", text)
    result = {}
    if files := re.search(r"Scanning Files: ?(\d+)/(\d+)", text):
        result["files"] = [int(files[1]), int(files[2])]
    elif files := re.search(r"Total Files Read: ?(\d+)", text):
        result["files"] = [int(files[1]), total]
    if groups := re.search(r"Row Groups Scanned: ?(\d+) ?/ ?(\d+)", text):
        result["row_groups"] = [int(groups[1]), int(groups[2])]
    return result


PRUNERS = {"polars": prune_polars, "pyarrow": prune_pyarrow, "duckdb": prune_duckdb}


def check_pruning(root, installed, first_run):
    telemetry = root / "telemetry"
    files = sorted(telemetry.rglob("*.parquet"))
    (sequence, actuator), run = first_run
    expected = len(list(telemetry.glob(f"sequence=*/actuator={actuator}/*.parquet")))
    summary = {}
    for library in installed:
        if library not in PRUNERS:
            continue
        try:
            got = PRUNERS[library](telemetry, actuator, run, len(files))
        except Exception as error:
            fail(f"telemetry: filter on actuator {actuator}, run {run} with {library}: {short(error)}")
            continue
        summary[library] = got
        if "files" not in got:
            notes.append(f"{library} does not say which files it reads")
        elif got["files"][0] != expected:
            fail(f"telemetry: a filter on actuator {actuator} reads {got['files'][0]} of {got['files'][1]} files with {library}, should be {expected}")
        if "row_groups" not in got:
            notes.append(f"{library} does not say which row groups it reads")
        elif got["row_groups"][1] > 1 and got["row_groups"][0] >= got["row_groups"][1]:
            fail(f"telemetry: a filter on run {run} reads all {got['row_groups'][1]} row groups with {library}; are there statistics?")
    return summary


# ---------------------------------------------------------------- files


def check_files(root):
    """Nothing in the tables' folders but Parquet files, nothing left over, the manifest's files are there."""
    if (root / "_staging").exists():
        fail("_staging is still there: the dataset is not merged")
    for table in REQUIRED + OPTIONAL:
        seen = {}
        for path in sorted((root / table).rglob("*")):
            relative = path.relative_to(root).as_posix()
            if (other := seen.setdefault(relative.lower(), relative)) != relative:
                fail(f"{relative} and {other} differ in case only: one folder on other systems")
            if path.is_file() and (path.name.startswith((".", "_")) or path.suffix != ".parquet"):
                fail(f"{relative}: no such file may stand in a table's folder; readers of the folder stumble over it")
            if path.is_file() and path.suffix == ".parquet" and path.stat().st_size < 12:
                fail(f"{relative}: {path.stat().st_size} bytes are no Parquet file")
            if path.is_dir() and table == "telemetry" and not any(path.iterdir()):
                fail(f"{relative}: empty folder")
    manifest = root / "manifest.json"
    if not manifest.exists():
        fail("manifest.json is missing: the dataset is not merged, or not whole")
        return
    try:
        listed = json.loads(manifest.read_text())["files"]
        listed = {f["path"]: f for f in listed} if isinstance(listed, list) else listed
        sizes = {path: f["bytes"] for path, f in listed.items()}
    except (ValueError, KeyError, TypeError) as error:
        fail(f"manifest.json: no list `files` with `path` and `bytes` ({short(error)})")
        return
    for path, size in sizes.items():
        if not (root / path).exists():
            fail(f"manifest.json names {path}, which is missing")
        elif (root / path).stat().st_size != size:
            fail(f"{path}: {(root / path).stat().st_size} bytes, {size} in manifest.json")
    for path in root.rglob("*.parquet"):
        name = path.relative_to(root).as_posix()
        # maps and diagnoses are made from a finished dataset
        if name not in sizes and not name.startswith(("maps/", "diagnoses/")):
            fail(f"{name} is not in manifest.json")


def check_versions(root, installed):
    """ema.schema_version in every file, read with whatever is there."""
    def version(path):
        if "pyarrow" in installed:
            import pyarrow.parquet as pq
            return (pq.read_metadata(path).metadata or {}).get(b"ema.schema_version", b"").decode()
        if "polars" in installed and "duckdb" not in installed:
            import polars as pl
            return pl.read_parquet_metadata(path).get("ema.schema_version", "")
        import duckdb
        rows = duckdb.execute(f"SELECT key, value FROM parquet_kv_metadata({sql_text(path)})").fetchall()
        return dict(rows).get(b"ema.schema_version", b"").decode()
    for path in sorted(root.rglob("*.parquet")):
        try:
            if (found := version(path)) != "1":
                fail(f"{path.relative_to(root).as_posix()}: ema.schema_version is {found!r}, should be '1'")
        except Exception as error:
            fail(f"{path.relative_to(root).as_posix()}: metadata: {short(error)}")


# ---------------------------------------------------------------- all


def check(root, expected, installed):
    check_files(root)
    check_versions(root, installed)
    readers = {k: v for k, v in READERS.items() if k in installed}
    tables, features, first_run = {}, {}, None
    for table in REQUIRED + OPTIONAL:
        want = expected.get(table)
        if not any((root / table).rglob("*.parquet")):
            if table in REQUIRED or want:
                fail(f"{table}: no Parquet file in {root / table}")
            tables[table] = "absent"
            continue
        found = {}
        for library, reader in readers.items():
            try:
                types, columns = reader(str(root / table), table == "telemetry")
                found[library] = numbers_of(table, types, columns)
            except Exception as error:
                fail(f"{table}: {library} cannot read it: {short(error)}")
                continue
            compare_spec(table, library, found[library])
            if want:
                compare_expected(table, library, found[library], want)
            if table in ("features", "diagnoses") and "run" in columns:
                runs = columns["run"][0]
                if (runs[1:] < runs[:-1]).any():
                    fail(f"{table}: rows are not sorted by run ({library})")
            if table == "features":
                features[library] = {c: columns[c] for c in ("run", "actuator", "sequence") if c in columns}
            if table == "telemetry" and all(c in columns for c in ("run", *HIVE)):
                if library in features:
                    compare_runs(library, features[library], columns)
                pairs, at = pairs_of(columns)
                if set(pairs) != set(folder_pairs(root / "telemetry")):
                    fail(f"telemetry: folders {sorted(folder_pairs(root / 'telemetry'))[:3]}... arrive as {sorted(pairs)[:3]}... with {library}")
                elif first_run is None:
                    pair = min(pairs)
                    runs = columns["run"][0][at == pairs.index(pair)]
                    first_run = (pair, int(runs[len(runs) // 2]))
            del columns
        if found:
            compare_libraries(table, found)
            tables[table] = next(iter(found.values()))
            tables[table]["libraries"] = list(found)
    for table in set(expected) - set(REQUIRED + OPTIONAL):
        fail(f"{table}: no such table")
    return tables, check_pruning(root, installed, first_run) if first_run else {}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--expect", help="JSON, or a file with it")
    parser.add_argument("--require", default="", help="libraries that must be there, comma separated, or `all`")
    args = parser.parse_args()
    versions = {}
    for library in LIBRARIES:
        try:
            versions[library] = importlib.import_module(library).__version__
        except ImportError:
            versions[library] = "skipped"
    if versions["pandas"] != "skipped" and versions["pyarrow"] == "skipped":
        versions["pandas"] = "skipped"
        notes.append("pandas reads Parquet with pyarrow, which is not installed")
    try:
        import numpy  # noqa: F401
    except ImportError:
        versions = {k: "skipped" for k in LIBRARIES}
        notes.append("numpy is not installed: nothing is read")
    installed = [k for k, v in versions.items() if v != "skipped"]
    for library in LIBRARIES if args.require == "all" else filter(None, args.require.split(",")):
        if library not in installed:
            fail(f"{library} is required, but not installed")
    expected = {}
    if args.expect:
        try:
            text = args.expect if args.expect.lstrip().startswith("{") else Path(args.expect).read_text()
            expected = json.loads(text)["tables"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            fail(f"--expect: {short(error)}")
    tables, pruning = {}, {}
    if not args.dataset.is_dir():
        fail(f"{args.dataset}: no such folder")
    elif not (args.dataset / "features").is_dir():
        fail(f"{args.dataset}: not a fleet dataset, it has no folder `features`")
    elif any(k in installed for k in READERS):
        tables, pruning = check(args.dataset, expected, installed)
    print(json.dumps({"ok": not failures, "libraries": versions, "tables": tables, "pruning": pruning,
                      "notes": notes, "failures": failures}, indent=1))
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
