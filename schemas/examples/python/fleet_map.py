"""Failure map of one actuator of a fleet dataset, from its Parquet files alone.

    pip install polars matplotlib
    python fleet_map.py DATASET [--actuator ID] [--out map.png]

Above, P1, P2 and P3 over FSJ, one curve per zeta, of one actuator (the first one, if none is named), and how
far they spread over the fleet. Below, if there are diagnoses, their intervals against the exact faults.
The ending of --out decides on the format (png, svg, pdf). The cells `# %%` run one by one in a notebook.

Exit code: 0 done, 2 command line, 4 no such dataset or actuator.
"""

# %% What is needed
import argparse
import sys
import textwrap
from pathlib import Path

import matplotlib.pyplot as plt
import polars as pl

parser = argparse.ArgumentParser(description="Failure map of one actuator of a fleet dataset.")
parser.add_argument("dataset", help="folder (or s3://bucket/prefix) with features/, actuators/ and more")
parser.add_argument("--actuator", metavar="ID", help="its map is drawn; the first one of the dataset if left out")
parser.add_argument("--out", metavar="FILE", default="map.png", help="picture, .png, .svg or .pdf (default: map.png)")
in_notebook = "ipykernel" in sys.modules
args = parser.parse_args(["dataset", "--out", "map.png"] if in_notebook else None)   # in a notebook: your dataset here


def stop(text):
    if in_notebook:
        raise RuntimeError(text)
    print(f"fleet_map: {text}", file=sys.stderr)
    sys.exit(4)


if Path(args.out).suffix.lower() not in (".png", ".svg", ".pdf"):
    parser.error(f"--out {args.out}: the name must end in .png, .svg or .pdf")

# %% Open the dataset
# Each table is a folder of Parquet files; nothing is read before it is needed.
REMOTE = "://" in args.dataset
ROOT = args.dataset.rstrip("/")


def table(name):
    """The table, or None where the dataset does not have it."""
    if not REMOTE and not any((Path(ROOT) / name).glob("*.parquet")):
        return None
    scan = pl.scan_parquet(f"{ROOT}/{name}/*.parquet")
    try:
        scan.collect_schema()
    except (pl.exceptions.ComputeError, FileNotFoundError, OSError) as error:
        if name == "features" or not REMOTE:
            stop(f"{ROOT}/{name}: {str(error).splitlines()[0]}")
        return None
    return scan


if not REMOTE and not Path(ROOT).is_dir():
    stop(f"{ROOT}: no such folder")
features = table("features")
if features is None:
    stop(f"{ROOT}: not a fleet dataset, there is no Parquet file in {ROOT}/features (not merged yet?)")

# %% Look at it
fleet = features.group_by("actuator", "kind", maintain_order=True).len().collect()
actuators = fleet["actuator"].unique(maintain_order=True).to_list()
print(f"{ROOT}: {fleet['len'].sum()} runs of {len(actuators)} actuators, "
      + ", ".join(f"{n} {kind}" for kind, n in fleet.group_by("kind", maintain_order=True).agg(pl.col("len").sum()).iter_rows()))
print(features.select("run", "actuator", "sequence", "kind", "fsj", "zeta", "p1_rad_per_s", "p2_a", "p3").head(3).collect())
drawn = table("actuators")
if drawn is not None:
    print(drawn.select("actuator", "supply_voltage_v", "phase_resistance_ohm", "dynamic_friction_ratio").head(3).collect())

actuator = args.actuator or actuators[0]
if actuator not in actuators:
    shown = ", ".join(actuators[:8]) + (f" and {len(actuators) - 8} more" if len(actuators) > 8 else "")
    stop(f"no actuator {actuator} in {ROOT}; there are {shown}")

# %% Telemetry, where it was kept: the greatest current of each run of the actuator
# The folder names are columns too. Their types are given, so that no id is taken for a number.
if not REMOTE and (Path(ROOT) / "telemetry").is_dir():
    telemetry = pl.scan_parquet(f"{ROOT}/telemetry/**/*.parquet", hive_schema={"sequence": pl.String, "actuator": pl.String})
    peaks = (telemetry.filter(pl.col("actuator") == actuator)
             .group_by("run", "fsj", "zeta").agg(pl.len().alias("samples"), pl.col("i_a").abs().max().alias("peak_i_a")).sort("run").collect())
    print(peaks.head(3) if len(peaks) else f"no telemetry of {actuator} was kept")

# %% The map: runs on the grid, of one sequence and one rest angle
grid = (features.filter(pl.col("kind") == "map")
        .select("actuator", "sequence", "rest_angle_rad", "fsj", "zeta", "p1_rad_per_s", "p2_a", "p3").collect())
own = grid.filter(pl.col("actuator") == actuator)
if own.is_empty():
    stop(f"{actuator} has no runs of kind `map` in {ROOT}")
sequence, rest_angle = own.select("sequence", "rest_angle_rad").row(0)
own = own.filter(pl.col("sequence") == sequence, pl.col("rest_angle_rad") == rest_angle).sort("zeta", "fsj")
same = grid.filter(pl.col("sequence") == sequence, pl.col("rest_angle_rad") == rest_angle)
PANELS = [("p1_rad_per_s", "P1, speed error in the step", "rad/s"),
          ("p2_a", "P2, current error in the sine", "A"),
          ("p3", "P3, starting error in the ramp", "times the healthy one")]
in_band = same["actuator"].n_unique()
low, high = (0.0, 1.0) if in_band < 20 else (0.05, 0.95)
band = same.group_by("zeta", "fsj").agg(
    pl.col(c).quantile(q, interpolation="linear").alias(f"{c}_{s}") for c, _, _ in PANELS for q, s in ((low, "lo"), (high, "hi"))).sort("zeta", "fsj")

# %% The diagnoses
diagnoses = table("diagnoses")
if diagnoses is not None:
    diagnoses = diagnoses.filter(pl.col("sequence") == sequence).collect()
    if "own" in diagnoses["maps"]:       # over its own maps, where they were made, else over those of the type
        diagnoses = diagnoses.filter(pl.col("maps") == "own")
    all_diagnoses = len(diagnoses)
    diagnoses = diagnoses.drop_nulls(["fsj_lo", "zeta_lo"])
    if diagnoses.is_empty():
        diagnoses = None

# %% Draw
INK, GREY, FAINT, MISS = "#1F2933", "#606C78", "#E6E9ED", "#C8372D"
plt.rcParams.update({
    "font.family": "sans-serif", "font.size": 10, "text.color": INK, "axes.labelcolor": INK, "axes.edgecolor": "#8C96A0",
    "xtick.color": GREY, "ytick.color": GREY, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
    "grid.color": FAINT, "axes.axisbelow": True, "svg.fonttype": "none",
})
zetas = own["zeta"].unique().sort().to_list()
span = (zetas[-1] - zetas[0]) or 1.0
colour = {z: plt.get_cmap("viridis")(0.85 * (z - zetas[0]) / span) for z in zetas}
banded = sorted({zetas[0], zetas[len(zetas) // 2], zetas[-1]})


def spread_labels(wanted, gap, low, high):
    """Heights as near to the wanted ones (rising) as a distance of `gap` and the ends allow."""
    blocks = []   # of labels that touch: [sum of the heights wanted for the lowest label, number]
    for y in wanted:
        blocks.append([y, 1])
        while len(blocks) > 1 and blocks[-2][0] / blocks[-2][1] + blocks[-2][1] * gap > blocks[-1][0] / blocks[-1][1]:
            total, n = blocks.pop()
            blocks[-1][0] += total - n * blocks[-1][1] * gap
            blocks[-1][1] += n
    heights = [total / n + k * gap for total, n in blocks for k in range(n)]
    for ends, step in ((reversed(range(len(heights))), -1), (range(len(heights)), 1)):   # back between the ends
        edge = high if step < 0 else low
        for k in ends:
            heights[k] = min(heights[k], edge) if step < 0 else max(heights[k], edge)
            edge = heights[k] + step * gap
    return heights


def draw_map(axes, column, title, unit, xlabel=True):
    ends = []
    for z in zetas:
        curve = own.filter(pl.col("zeta") == z)
        if in_band > 1 and z in banded:
            b = band.filter(pl.col("zeta") == z)
            axes.fill_between(b["fsj"], b[f"{column}_lo"].cast(pl.Float64), b[f"{column}_hi"].cast(pl.Float64), color=colour[z], alpha=0.22, lw=0)
        axes.plot(curve["fsj"], curve[column].fill_null(float("nan")), color=colour[z], lw=1.5)
        known = curve.filter(pl.col(column).is_not_null())
        if len(known):
            ends.append((known[column][-1], z, known["fsj"][-1]))
    axes.set_title(title, loc="left", fontweight="bold", fontsize=11, pad=22)
    axes.text(0, 1.03, f"[{unit}]", transform=axes.transAxes, color=GREY)
    axes.set_xlabel("friction factor FSJ")
    if not ends:
        axes.text(0.5, 0.5, "no values", transform=axes.transAxes, color=GREY, ha="center")
        axes.set_axis_off()
        return
    if own["fsj"].n_unique() > 1:
        axes.set_xlim(own["fsj"].min(), own["fsj"].max())
    if (own[column].min() or 0) < 0.15 * (own[column].max() or 0):
        axes.set_ylim(bottom=min(0, own[column].min() or 0))
    # direct legend: each curve's zeta at its right end
    ends.sort()
    low, high = axes.get_ylim()
    places = spread_labels([(end - low) / (high - low) for end, _, _ in ends], min(0.048, 1 / max(len(ends), 1)), 0.02, 0.98)
    left, right = axes.get_xlim()
    for y, (end, z, x) in zip(places, ends):
        axes.plot([(x - left) / (right - left), 1.045], [(end - low) / (high - low), y], color=colour[z], lw=0.6, transform=axes.transAxes, clip_on=False)
        axes.annotate(f"{z:.2f}", (1.055, y), xycoords="axes fraction", color=colour[z], fontsize=8.5, va="center")
    axes.annotate("zeta", (1.055, 1.03), xycoords="axes fraction", color=GREY, fontsize=8.5)


def draw_diagnoses(axes, fault, name):
    inside = pl.col(fault).is_between(pl.col(f"{fault}_lo"), pl.col(f"{fault}_hi"))
    is_own = pl.col("actuator") == actuator
    held = diagnoses.select(inside.sum()).item()
    ends = (min(own[fault].min(), diagnoses[fault].min()), max(own[fault].max(), diagnoses[fault].max()))
    axes.plot(ends, ends, color=GREY, lw=0.8, zorder=1)
    axes.annotate("exact", (ends[1], ends[1]), (4, 0), textcoords="offset points", color=GREY, fontsize=8.5, va="center", annotation_clip=False)
    kinds = [(inside & is_own, "#2563A8", actuator, 4), (inside & ~is_own, "#A3ADB8", "other actuators", 2), (~inside, MISS, "does not hold the exact value", 3)]
    height = 0.97
    for mask, ink, label, order in kinds:
        part = drawn_diagnoses.filter(mask)
        if part.is_empty():
            continue
        axes.vlines(part[fault], part[f"{fault}_lo"], part[f"{fault}_hi"], color=ink, lw=1.8, zorder=order)
        axes.plot(part[fault], part[f"{fault}_estimate"], ".", color=ink, ms=6, zorder=order)
        axes.text(0.02, height, label, transform=axes.transAxes, color=ink if ink != "#A3ADB8" else GREY, va="top", fontweight="bold", fontsize=9)
        height -= 0.062
    axes.set_title(f"Diagnosed {name}: interval and estimate", loc="left", fontweight="bold", fontsize=11, pad=22)
    wanted = diagnoses["coverage"][0]
    wanted = "not calibrated" if wanted is None else f"asked for are {100 * wanted:.0f} %"
    axes.text(0, 1.03, f"{held} of {len(diagnoses)} intervals ({100 * held / len(diagnoses):.1f} %) hold the exact value; {wanted}",
              transform=axes.transAxes, color=GREY)
    axes.set_xlabel(f"exact {name}")
    axes.set_ylabel(f"diagnosed {name}")


drawn_diagnoses = diagnoses
if diagnoses is not None and len(diagnoses) > 300:   # more would be a grey wall
    mine, others = (diagnoses.filter(pl.col("actuator") == actuator), diagnoses.filter(pl.col("actuator") != actuator))
    drawn_diagnoses = pl.concat([mine.head(100), others.sample(min(200, len(others)), seed=1)])
rows = 1 if diagnoses is None else 2
figure = plt.figure(figsize=(12, 5.2 if rows == 1 else 9.8), layout="constrained")
figure.get_layout_engine().set(w_pad=0.12, h_pad=0.14, hspace=0.0, wspace=0.03)
above, *below = [figure] if rows == 1 else figure.subfigures(2, 1, height_ratios=(1, 1))
for axes, panel in zip(above.subplots(1, 3), PANELS):
    draw_map(axes, *panel)
caption = f"Curves are those of {actuator} in the sequence {sequence}, rest angle {rest_angle:g} rad."
if in_band > 1:
    caption += f" Bands: where {'all' if in_band < 20 else '90 % of the'} {in_band} actuators are, for zeta " + ", ".join(f"{z:.2f}" for z in banded) + "."
lines = textwrap.wrap(caption, 150)
if diagnoses is not None:
    lines.append(f"{len(diagnoses)} of {all_diagnoses} diagnoses have an interval"
                 + (f", {len(drawn_diagnoses)} are drawn." if len(drawn_diagnoses) < len(diagnoses) else "."))
figure.suptitle(f"Failure map of actuator {actuator}" + "\n" * len(lines), x=0.012, ha="left", fontsize=15, fontweight="bold")
figure.text(0.012, 1 - 0.50 / figure.get_figheight(), "\n".join(lines), color=GREY, va="top")
if below:
    for axes, fault, name in zip(below[0].subplots(1, 2), ("fsj", "zeta"), ("FSJ", "zeta")):
        draw_diagnoses(axes, fault, name)

# %% Save
try:
    figure.savefig(args.out, dpi=160)
except OSError as error:
    stop(f"{args.out}: {error.strerror or error}")
print(f"{args.out} written")
