"""Whether any two numbers of one answer contradict each other."""

from typing import Any

ROUNDING = 1e-9

NAMED = ("explained", "parametric_only")
UNNAMED = ("no_gap", "negligible", "not_testable")


def contradictions(answer: dict[str, Any]) -> list[str]:
    """Sentences, one a contradiction; none of an answer that is consistent."""
    far, status = answer["how_far"], answer["status"]
    out: list[str] = []
    # One gap and one noise a joint, wherever they stand.
    joints = {j["joint"]: j for j in far["per_joint"]}
    for place in answer["where"]["joints"]:
        own = joints[place["joint"]]
        if abs(place["gap_rms"] - own["before"]) > ROUNDING + 1e-6 * own["before"]:
            out.append(
                f"joint {place['joint']}: gap {place['gap_rms']:.3g} and {own['before']:.3g}"
            )
        if place["noise_floor_rms"] != own["noise_floor_rms"]:
            out.append(f"joint {place['joint']}: two noises")
    for j, own in joints.items():
        # The upper end is open where no repeat tells it.
        low, high = (own["noise_floor_rms"][0] if x is None else x for x in own["noise_floor_rms"])
        if not 0 <= low <= high * (1 + 1e-6) + ROUNDING:
            out.append(f"joint {j}: noise from {low:.3g} to {high:.3g}")
        if high > own["before"] * (1 + 1e-6) + ROUNDING:
            out.append(f"joint {j}: noise {high:.3g} above the gap {own['before']:.3g}")
    # Names are likelier than not, and sizes are above or below what was asked for.
    causes, small = (answer["answer"][key] for key in ("causes", "small"))
    for entry in [*causes, *small]:
        if entry.get("how_sure") is not None and entry["how_sure"] < 0.5:
            out.append(f"{entry['effect']} {entry['joints']}: sure to {entry['how_sure']:.2f}")
    both = {(w["effect"], *w["joints"]) for w in answer["which"]}
    for entry in small:
        if (entry["effect"], *entry["joints"]) in both:
            out.append(f"{entry['effect']} {entry['joints']}: told, and called small")
    # What the status says is there.
    named = bool(causes)
    if named != (status in NAMED) and status in (*NAMED, *UNNAMED):
        out.append(f"{status}, with {len(answer['which'])} names")
    if (status == "negligible") != (bool(small) and status in UNNAMED[:2]):
        out.append(f"{status}, with {len(small)} small causes")
    if not named and far["closed"] is not None:
        out.append(f"nothing is named and {far['closed']:.0%} closed")
    if far["closed"] is not None and not far["closed_ci95"][0] <= far["closed"] <= 1 + ROUNDING:
        out.append(f"closed {far['closed']} outside of {far['closed_ci95']}")
    return out
