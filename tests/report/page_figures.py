"""Reads a written page back: its tables, what a number as printed stands for, and what each figure has to be.

What a table shows is computed here from the rest of the JSON beside the page, by row and column; nothing of the code
that writes pages is used.
"""

from __future__ import annotations

import base64
import math
import re
import zlib
from itertools import pairwise

import numpy as np

NOTHING = (None, "–", "no gap", "")
FACTOR = {  # one SI unit in the unit shown; any other unit is SI itself
    "": 1.0, "rad": 1.0, "°": 180 / np.pi, "bar": 1e-5, "Pa": 1.0, "mm": 1e3, "mm/s": 1e3, "m/s": 1.0, "ms": 1e3,
    "s": 1.0, "rpm": 30 / np.pi, "°/s": 180 / np.pi, "L/min": 6e4, "cm³": 1e6, "cm²": 1e4, "cm³/rev": 2e6 * np.pi,
    "mL/(min·bar)": 6e12, "%": 1.0, "rad/s": 1.0, "Hz": 1.0, "N": 1.0, "kg": 1.0, "V": 1.0,
}  # fmt: skip
PERCENT = ("share", "gap_closed", "probability", "change", "explained")  # columns of shares, printed as percent


def unpacked(page: str, name: str) -> list[str]:
    """The texts of a page's packed scripts of this class, by zlib."""
    found = re.findall(rf'<script type="text/plain" class="{name}" data-size="(\d+)">(.*?)</script>', page)
    texts = [zlib.decompress(base64.b64decode(packed), wbits=-15) for _, packed in found]
    assert [len(text) for text in texts] == [int(size) for size, _ in found]
    return [text.decode("utf-8") for text in texts]


def number(text: str) -> float:
    return float(text.replace("−", "-").replace("\u202f", "").replace("\u00a0", "").replace("∞", "inf"))


def half_a_digit(text: str) -> float:
    """Half of the last digit of a number as printed; large whole numbers have three digits."""
    mantissa, _, power = text.replace("−", "-").replace("\u202f", "").partition("e")
    decimals = len(mantissa.partition(".")[2])
    if "." not in mantissa and not power and len(mantissa.strip("-")) > 4:
        decimals = 2 - len(mantissa.strip("-"))
    return 0.501 * 10.0 ** (int(power or 0) - decimals)


def shows(text: str, value: float | None, factor: float = 1.0) -> bool:
    """Whether a number as printed is this value, in a unit of which one SI unit is ``factor``."""
    if value is None or not math.isfinite(value):
        return text in NOTHING or "∞" in text
    if "%" in text:
        value, text = 100.0 * value, text.replace("%", "").strip().replace("\u00a0", "")
        if "over" in text:
            return value > 99.9
        if "under" in text:
            return 0.0 < value < 1.0
    return abs(number(text) - factor * value) <= half_a_digit(text) * (1 + 1e-6)


def gap_figures(data: dict) -> dict[str, list[dict]]:
    """Rows of every table of a gap page, {column: SI value}, by the id of the table."""
    seen = data["validate"] or data["train"]
    tables = {"headline": [_output(row) for row in seen.values()]}
    tables["locations"] = sorted(({"times_noise": p["times_noise"]} for p in data["locations"]), key=_worst)
    looks = sorted({c["step"] for c in data["candidates"]})
    for look in looks:
        rows = [c for c in data["candidates"] if c["step"] == look]
        name = f"candidates_{look if look <= len(data['steps']) else 'last'}"
        fitted = [c for c in rows if c["left"] is not None or c["fate"] in ("named", "in class")]
        tables[name] = fitted or rows[:12]
        tables[f"{name}_rest"] = [c for c in rows if c not in tables[name]]
    for k, step in enumerate(data["steps"], 1):
        tables[f"effect_{k}"] = list(step["parameters"].values())
        known = {(c["effect"], c["site"]): c for c in data["candidates"] if c["step"] == k}
        tables[f"members_{k}"] = [known[m["effect"], m["site"]] for m in step["members"]]
    tables["sure"] = _odds(data["probabilities"])
    left = [r["times_noise"] ** 2 - 1 for r in data["waterfall"]]
    closed = [None, *((a - b) / left[0] for a, b in pairwise(left))][: len(left)]
    tables["waterfall"] = [{**r, "gap_closed": c} for r, c in zip(data["waterfall"], closed, strict=True)]
    tables["shifts"] = [_shift(s) for s in data["shifts"]]
    tables["fit_after"] = _parameters(data["parameters"])
    order = {"report": 0, "fit": 1}
    recordings = sorted(data["recordings"], key=lambda r: order[r["role"]])
    for output in dict.fromkeys(o for r in recordings for o in r["outputs"]):
        of = [r["outputs"][output] for r in recordings if output in r["outputs"]]
        tables[f"recordings_{output}"] = [_output(row) for row in of]
    tables["unknown"] = data["unknown"]
    tables["noise"] = [{"noise": v} for v in data["noise"].values()]
    tables["timings"] = [{"seconds": data["seconds"]}]
    tables["digests"] = data["fit_records"]
    return tables


def _worst(row: dict) -> float:
    return -row["times_noise"]


def _odds(odds: dict[str, float]) -> list[dict]:
    """The most likely first, what is spread over many, something else last."""
    known = sorted((p for name, p in odds.items() if name != "something else"), reverse=True)
    rest = 1 - sum(odds.values())
    rows = [*known, *([rest] if rest >= 0.005 else []), *([odds["something else"]] if odds else [])]
    return [{"probability": p} for p in rows]


def _output(row: dict) -> dict:
    before, after, noise = row["rmse_before"], row["rmse_after"], row["noise"]
    gap = before**2 - noise**2
    closed = min(1.0, 1 - (after**2 - noise**2) / gap) if before**2 > 1.02 * noise**2 else None
    return {**row, "gap_closed": closed, "times_noise": after / noise}


def _shift(s: dict) -> dict:
    known = [v for v in (s["sigma_before"], s["sigma_after"]) if v is not None]
    moved = s["after"] - s["before"]
    return {**s, "change": moved / abs(s["before"]), "sigmas": moved / math.hypot(*known) if known else None}


def _parameters(rows: list[dict]) -> list[dict]:
    found = []
    for r in rows:
        reach = None if r["sigma"] is None else 1.959964 * r["sigma"]
        low, high = (None, None) if reach is None else (r["value"] - reach, r["value"] + reach)
        shift = 100 * (r["value"] - r["start"]) / abs(r["start"]) if r["start"] else None
        found.append({**r, "low": low, "high": high, "shift": shift})
    return found


BANDS = ("coverage", "crps", "nlpd")  # how a band holds, of models that have one


def compare_figures(data: dict) -> dict[str, list[dict]]:
    """The same of a page of `compare` or of `identify --report`."""
    yardsticks = {m["name"] for m in data["models"] if m["kind"] == "yardstick"}
    means, tables = _means(data["scores"]), {}
    outputs = list(dict.fromkeys(s["output"] for s in data["scores"]))
    for mode in data["modes"]:
        for output in outputs:
            ranked = [m for m in means if (m["mode"], m["output"]) == (mode, output)]
            tables[f"scores_{mode.replace(' ', '_')}_{output}"] = ranked
            rows = [s for s in data["scores"] if (s["mode"], s["output"]) == (mode, output)]
            tables[f"recordings_{mode.replace(' ', '_')}_{output}"] = _relative(rows)
    tables["field"] = _field(data["scores"], yardsticks)
    first = {}
    for t in data["run_time"]:
        first.setdefault(t["model"], 1 / t["seconds_per_simulated_second"])
    free = [m for m in means if m["mode"] == data["modes"][0]]
    tables["headline"] = [
        {
            "model": m["name"],
            "real_time_factor": None if m["name"] in yardsticks else first.get(m["name"]),
            "fit_percent": _of(free, m["name"], outputs[0]).get("fit_percent"),
            **{o: _of(free, m["name"], o).get("rmse") for o in outputs},
        }
        for m in data["models"]
    ]
    tables["run_times"] = [
        {**t, "seconds": t["seconds_per_simulated_second"], "real_time_factor": 1 / t["seconds_per_simulated_second"]}
        for t in data["run_time"]
    ]
    tables["domain"] = [
        {**d, "model": d["model"] or "training recordings", "inside": d["inside_percent"]} for d in data["domain"]
    ]
    left = [r | {"explained": r["explained_percent"], "white": r["white_percent"]} for r in data["residuals"]]
    left = [r | ({} if r["follows"] else {"strength": None, "lag": None}) for r in left]
    for output in outputs:
        tables[f"residuals_{output}"] = [r for r in left if r["output"] == output]
    for k, fit in enumerate(data["fits"], 1):
        name = "fit" if k == 1 else f"fit-{k}"
        tables[f"{name}_parameters"] = _parameters(fit["parameters"])
        tables[f"{name}_residuals"] = [r | {"ratio": r["rmse"] / r["noise"]} for r in fit["residuals"]]
    tables["recordings"] = [r | {"record": r["name"], "duration": r["seconds"]} for r in data["recordings"]]
    return tables


def _field(scores: list[dict], yardsticks: set[str]) -> list[dict]:
    """Means over the recordings of the metrics of the field, free run, and the rating from its parts."""
    groups: dict[tuple, list[dict]] = {}
    for s in scores:
        if s["mode"] == "free run" and s["model"] not in yardsticks:
            groups.setdefault((s["output"], s["model"]), []).append(s)
    rows, keys = [], ("r2", "theil", "lag", "corridor", "phase", "magnitude", "slope")
    for (output, model), of in groups.items():
        mean = {k: float(np.mean([s[k] for s in of])) for k in keys}
        whole = 0.4 * mean["corridor"] + 0.2 * (mean["phase"] + mean["magnitude"] + mean["slope"])
        for key in ("settling", "steady", "u_val", "vv20"):
            known = [s[key] for s in of if s[key] is not None]
            mean[key] = float(np.mean(known)) if known else None
        rows.append({"output": output, "model": model, "iso18571": whole, **mean})
    return rows


def _of(means: list[dict], model: str, output: str) -> dict:
    return next((m for m in means if (m["model"], m["output"]) == (model, output)), {})


def _means(scores: list[dict]) -> list[dict]:
    groups: dict[tuple, list[dict]] = {}
    for s in scores:
        groups.setdefault((s["mode"], s["output"], s["model"]), []).append(s)
    rows = []
    for (mode, output, model), of in groups.items():
        mean = {k: float(np.mean([s[k] for s in of])) for k in ("rmse", "mae", "fit_percent", "bias")}
        rows.append({"mode": mode, "output": output, "model": model, "record": "", "count": len(of), **mean})
        rows[-1]["maximum"] = max(s["maximum"] for s in of)
        rows[-1] |= {k: float(np.mean([s[k] for s in of])) for k in BANDS if all(s.get(k) is not None for s in of)}
    return _relative(rows)


def _relative(rows: list[dict]) -> list[dict]:
    """With the RMSE over the smallest of all that were scored on as many recordings."""
    found = []
    for row in rows:
        rivals = [r for r in rows if all(r[k] == row[k] for k in ("mode", "output", "record"))]
        most = max(r.get("count", 1) for r in rivals)
        best = min(r["rmse"] for r in rivals if r.get("count", 1) == most)
        inside = {} if row.get("coverage") is None else {"coverage": 100 * row["coverage"]}
        found.append({**row, **inside, "relative": row["rmse"] / best if row.get("count", 1) == most else None})
    return found


def sentences(data: dict) -> str:
    """What stands in words on the first screen."""
    return "\n".join([data["answer"], *data["facts"], *data["notices"]])


def numbers_in(text: str) -> list[str]:
    """The numbers of a text, with their percent signs; not those in names."""
    return re.findall(r"(?<![\w.^(])[−-]?\d[\d\u202f]*(?:\.\d+)?(?:e[−-]?\d+)?(?:\u00a0%|\s%)?(?![\w^])", text)


def leaves(value) -> list[float]:
    """All numbers that JSON holds outside its tables, and how many things its lists hold."""
    if isinstance(value, dict):
        return [x for k, v in value.items() if k != "tables" for x in leaves(v)]
    if isinstance(value, list):
        return [float(len(value)), *(x for v in value for x in leaves(v))]
    return [float(value)] if isinstance(value, int | float) and not isinstance(value, bool) else []
