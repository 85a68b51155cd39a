"""How a run learns: what is delivered, and what was tried since."""
from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Method:
    """What two runs of the same data may differ in beyond train.py's options."""

    steps: int  # unless --steps says otherwise
    cut_share: float  # of the views of one COCO picture: a person whom the edge cuts, where there is one
    cut_rendered: bool  # rendered pictures as well: people and vehicles
    nothing_share: float  # of the views of one COCO picture: a part of it that shows nothing, magnified
    rendered_eighths: int  # of a step's views, with --simulated
    gates_as_seen: bool  # CBAM begins by what it sees (model.Cbam.begin), and not by chance
    attention_rate: float  # CBAM's rate, of the heads'


METHODS = {
    "delivered": Method(steps=2300, cut_share=0.25, cut_rendered=False, nothing_share=0.0, rendered_eighths=2,
                        gates_as_seen=False, attention_rate=10.0),
    # Gates that follow what they see to the end. The layers behind were not taught to expect them: CBAM learns at less than a
    # third of their rate, so that they come to use the gates rather than the gates to be constants. Spread after 450
    # steps, started at 0.06: 0.018, 0.026, 0.037 and 0.035 at 10, 3, 1 and 0.3 times the rate; at 0.1: 0.048 and 0.050 at 1 and 0.3.
    # With gates from 0.5 and cut_share 0.2 (commit 24646f6) it found 0.46 of the simulator's vehicles instead of 0.29, fewer people
    # cut by the edge, and less of COCO (../models/README.md).
    "moving-gates": Method(steps=2100, cut_share=0.25, cut_rendered=True, nothing_share=0.1, rendered_eighths=1,
                           gates_as_seen=True, attention_rate=0.3),
    # As delivered, but for rendered vehicles from near and cut by the edge. In the mean with the two of "delivered" the simulator's
    # vehicles are found twice as often (../models/README.md). They begin as those do: gates by chance.
    "vehicles": Method(steps=1300, cut_share=0.25, cut_rendered=True, nothing_share=0.1, rendered_eighths=1,
                       gates_as_seen=False, attention_rate=10.0),
    "vehicles-quarter": Method(steps=1300, cut_share=0.25, cut_rendered=True, nothing_share=0.1, rendered_eighths=2,
                               gates_as_seen=False, attention_rate=10.0),
}
DEFAULT = "delivered"
VEHICLES = ("vehicles", "vehicles-quarter")  # the two that the delivered weights are made of beside DEFAULT's two
