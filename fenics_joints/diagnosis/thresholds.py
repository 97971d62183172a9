"""Numbers that several files of a diagnosis decide by; ``docs/thresholds.md`` lists all of them."""

from __future__ import annotations

#: Probability of every interval: a lower end above zero is a difference from zero with 95 %.
#: [decision: convention]
INTERVAL = 0.9
#: p-value below which a hypothesis fits the data so badly that it explains nothing. [decision:
#: convention]
MISFIT = 0.01
#: Odds at which evidence is strong: held-out data then confirm one of several causes, a point mass
#: is reported, and a member of a class that is so much less probable than the best leaves it.
#: [decision: convention: strong, Kass and Raftery 1995]
STRONG = 20.0
#: What is so small beside a standard deviation, or beside the largest of its kind, counts for
#: nothing: an error of a reduced model, a difference of two predictions, a change that is too small
#: to be tested, a gain of D, a small part of a combination. [decision: adds 0.5 % to a standard
#: deviation]
NEGLIGIBLE = 0.1
#: Step of central differences, in standard deviations of the prior. [numerical: chosen]
STEP = 1e-5
#: Relative difference of two values that are the same but for round-off. [numerical: chosen]
ROUND_OFF = 1e-8
