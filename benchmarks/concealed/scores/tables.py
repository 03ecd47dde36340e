"""Sum judgements up, with Clopper-Pearson intervals."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from statistics import median
from typing import Any

from benchmarks.concealed.scores.compact import STOPPED
from benchmarks.concealed.scores.score import DECADES


def interval(hits: int, of: int, level: float = 0.95) -> tuple[float, float]:
    """Return the Clopper-Pearson interval of a share."""
    from scipy.stats import beta

    tail = (1 - level) / 2
    low = float(beta.ppf(tail, hits, of - hits + 1)) if hits else 0.0
    high = float(beta.ppf(1 - tail, hits + 1, of - hits)) if hits < of else 1.0
    return low, high


def _count(flags: list[Any]) -> dict[str, Any]:
    """Return hits, number, share and interval of flags; None is left out."""
    known = [bool(flag) for flag in flags if flag is not None]
    hits, of = sum(known), len(known)
    return {
        "hits": hits,
        "of": of,
        "share": hits / of if of else None,
        "interval95": interval(hits, of) if of else None,
    }


def _numbers(values: Sequence[float | None]) -> dict[str, Any]:
    known = sorted(v for v in values if v is not None)
    if not known:
        return {"of": 0}
    return {
        "of": len(known),
        "mean": sum(known) / len(known),
        "median": median(known),
        "p90": known[min(len(known) - 1, int(0.9 * len(known)))],
    }


def summary(judged: list[dict[str, Any]]) -> dict[str, Any]:
    """Return all shares of a set of judgements; `done` are those that have a diagnosis."""
    done = [item for item in judged if item["verdict"] is not None]
    kind = {
        name: [item for item in done if item["kind"] == name] for name in ("nothing", "one", "two", "alias", "outside")
    }
    known = kind["one"] + kind["two"]
    rows = [(item, physics) for item in known for physics in item["missing"]]
    out: dict[str, Any] = {
        "cases": len(judged),
        "diagnosed": len([item for item in done if item["verdict"] != STOPPED]),
        "named": _count([item["named"][physics] for item, physics in rows]),
        "named_one": _count([item["named"][item["missing"][0]] for item in kind["one"]]),
        "named_both": _count([all(item["named"].values()) for item in kind["two"]]),
        "named_exactly": _count([item["exact"][physics] for item, physics in rows]),
        "located": _count([item["located"].get(physics) for item, physics in rows]),
        "listed": _count([item["listed"].get(physics) for item, physics in rows]),
        "credit": _numbers([item["credit"].get(physics) for item, physics in rows]),
        "place_classes": _numbers([item["place_classes"] for item in known]),
        "places": _numbers([item["places"] for item in known]),
        "false_name": _count([bool(item["false_names"]) for item in known]),
        "false_alarm": _count([item["verdict"] not in ("consistent", STOPPED) for item in kind["nothing"]]),
        "missed": _count([item["verdict"] == "consistent" for item in known]),
        "abstained": _count([item["verdict"] != "consistent" and not item["class_sizes"] for item in known]),
        "outside_recognised": _count([item["verdict"] == "outside_catalogue" for item in kind["outside"]]),
        "outside_named_as_a_row": _count([bool(item["false_names"]) for item in kind["outside"]]),
        "alias_said": _count([item["right"] for item in kind["alias"]]),
        "alias_absorbed": _count([item["verdict"] == "consistent" for item in kind["alias"]]),
        "alias_false_name": _count([bool(item["false_names"]) for item in kind["alias"]]),
        "verdict_right": {name: _count([item["right"] for item in items]) for name, items in kind.items()},
        "cpu_s": {name: _numbers([item["cpu_s"] for item in items]) for name, items in kind.items()},
        "class_size": _numbers([float(size) for item in known for size in item["class_sizes"]]),
    }
    out["named_by_detectability"] = {
        f"D {low:g} to {high:g}": _count(
            [item["named"][p] for item, p in rows if low <= (item["detectability"] or 0) < high]
        )
        for low, high in DECADES
    }
    for name, key in (("effect_parameters", "parameters"), ("free_parameters", "free")):
        found = [number for item in done for number in item[key]]
        by_name: dict[str, list[dict[str, Any]]] = defaultdict(list)
        for number in found:
            by_name[f"{number['physics']}.{number['name']}" if "physics" in number else number["name"]].append(number)
        out[name] = {
            "error": _numbers([number["error"] for number in found]),
            "coverage90": _count([number["covered"] for number in found]),
            "each": {
                k: {"error": _numbers([n["error"] for n in v]), "coverage90": _count([n["covered"] for n in v])}
                for k, v in sorted(by_name.items())
            },
        }
    out["held_out_gain"] = {
        "of_one_and_two": _numbers([item.get("gain") for item in known]),
        "of_what_is_achievable": _numbers([item.get("achieved") for item in known]),
        "after_over_floor": _numbers(
            [item["after"] / item["floor"] for item in known if item.get("after") and item.get("floor")]
        ),
        "at_least_90_%": _count([item["gain"] >= 0.9 for item in known if item.get("gain") is not None]),
        "noise_floor_claimed_over_true": _numbers(
            [item["floor"] / item["true_floor"] for item in done if item.get("floor") and item.get("true_floor")]
        ),
    }
    each: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for item, physics in rows:
        each[physics].append({"named": item["named"][physics], "exact": item["exact"][physics]})
    out["rows"] = {
        k: {"named": _count([v["named"] for v in vs]), "exact": _count([v["exact"] for v in vs])}
        for k, vs in sorted(each.items())
    }
    laws: dict[str, list[bool]] = defaultdict(list)
    for item in kind["outside"]:
        laws[str(item["law"])].append(item["verdict"] == "outside_catalogue")
    out["laws"] = {law: _count(list(flags)) for law, flags in sorted(laws.items())}
    return out


def _share(count: dict[str, Any]) -> str:
    if not count["of"]:
        return "-"
    low, high = count["interval95"]
    return f"{count['hits']}/{count['of']} = {100 * count['share']:.0f} % ({100 * low:.0f} to {100 * high:.0f} %)"


def _spread(numbers: dict[str, Any], percent: bool = True) -> str:
    if not numbers["of"]:
        return "-"
    scale, unit = (100, " %") if percent else (1, "")
    return (
        f"median {scale * numbers['median']:.3g}{unit}, 90 % below {scale * numbers['p90']:.3g}{unit} ({numbers['of']})"
    )


LINES = (
    ("named", "effects named, with credit for the class"),
    ("named_one", "... where one is missing"),
    ("named_both", "both named, where two are missing"),
    ("named_exactly", "effects named exactly"),
    ("located", "effects located"),
    ("listed", "... or at any place reported"),
    ("false_name", "cases with a name that is wrong"),
    ("missed", "cases with an effect called consistent"),
    ("abstained", "cases with an effect and no name given"),
    ("false_alarm", "false alarms where nothing is missing"),
    ("outside_recognised", "outside the catalogue, recognised"),
    ("outside_named_as_a_row", "outside the catalogue, called a row"),
    ("alias_said", "aliases said to be such, or named"),
    ("alias_absorbed", "aliases called consistent"),
    ("alias_false_name", "aliases given a name outside the class"),
)


def markdown(result: dict[str, Any], title: str) -> str:
    """Return the summary as a page; intervals are Clopper-Pearson at 95 %."""
    lines = [
        f"# {title}",
        "",
        f"{result['diagnosed']} of {result['cases']} cases diagnosed. Intervals: Clopper-Pearson, 95 %.",
        "",
    ]
    lines += ["| | |", "|---|---|", *(f"| {text} | {_share(result[key])} |" for key, text in LINES)]
    lines += [f"| verdict right, {kind} | {_share(count)} |" for kind, count in result["verdict_right"].items()]
    lines += [f"| named, {band} | {_share(count)} |" for band, count in result["named_by_detectability"].items()]
    lines += [
        f"| {text} | mean {result[key]['mean']:.3g} ({result[key]['of']}) |"
        for key, text in (
            ("class_size", "size of the classes named"),
            ("credit", "names, 1/n in a class of n"),
            ("place_classes", "classes of places reported"),
            ("places", "places in them"),
        )
        if result[key]["of"]
    ]
    for kind, seconds in result["cpu_s"].items():
        if seconds["of"]:
            lines.append(f"| CPU seconds a case, {kind} | {_spread(seconds, percent=False)} |")
    gain = result["held_out_gain"]
    lines.append(f"| log(before/after) over log(before/noise floor), held-out | {_spread(gain['of_one_and_two'])} |")
    achieved = gain["of_what_is_achievable"]
    if achieved["of"]:  # the maker of the set says how far its true structures come
        lines.append(f"| ... as a share of what the true structure, refitted, achieves | {_spread(achieved)} |")
    lines.append(f"| ... at least 90 % | {_share(gain['at_least_90_%'])} |")
    lines.append(f"| error after over noise floor, held-out | {_spread(gain['after_over_floor'], percent=False)} |")
    lines.append(
        f"| noise floor claimed over the true one | {_spread(gain['noise_floor_claimed_over_true'], percent=False)} |"
    )
    for key, text in (("effect_parameters", "parameters of the effects"), ("free_parameters", "free parameters")):
        lines.append(f"| error of {text} | {_spread(result[key]['error'])} |")
        lines.append(f"| coverage of their 90 % intervals | {_share(result[key]['coverage90'])} |")
    lines += ["", "| row | named | exactly |", "|---|---|---|"]
    lines += [f"| {name} | {_share(c['named'])} | {_share(c['exact'])} |" for name, c in result["rows"].items()]
    if result["laws"]:
        lines += ["", "| law outside the catalogue | recognised |", "|---|---|"]
        lines += [f"| {name} | {_share(count)} |" for name, count in result["laws"].items()]
    lines += ["", "| parameter | error | coverage of 90 % intervals |", "|---|---|---|"]
    for key in ("free_parameters", "effect_parameters"):
        lines += [
            f"| {n} | {_spread(c['error'])} | {_share(c['coverage90'])} |" for n, c in result[key]["each"].items()
        ]
    return "\n".join(lines) + "\n"
