from dataclasses import replace

import numpy as np
import pytest

from data_tools.checking.corrections import AS_GIVEN
from data_tools.checking.report import FITS, Finding, Report


def report_of(sample, kind="masks"):
    count = len(sample.instances)
    return Report(sample, kind, np.ones(count), [AS_GIVEN] * count, np.ones(count))


def test_lines(sample):
    report = report_of(sample)
    report.facts.append("masks: all well")
    report.notes.append("depth: none")
    *head, last = report.lines()
    assert head == [
        "looked at 8 images and 16 objects in them, 16 of which are large enough to compare",
        "masks: all well",
        "note: depth: none",
    ]
    assert report.fine and last == "fine: models, poses, camera and images fit together"
    report.findings += [
        Finding("one", "it is off", ("before", "after")),
        Finding("two", "its size", objects=(3,)),
        Finding("three", "their size", objects=(3, 8)),
    ]
    assert not report.fine and report.keys == ["one", "two", "three"]
    assert list(report.lines())[3:] == [
        "OFF: one: it is off",
        "     before",
        "     after",
        "OFF: two: object 3: its size",
        "OFF: three: objects 3, 8: their size",
    ]


def test_small_objects_fit_less(sample):
    assert report_of(sample).least == pytest.approx(FITS["masks"], abs=0.12)
    assert report_of(sample, "depth").least == FITS["depth"]
    small = np.zeros((120, 160), bool)
    small[:6, :6] = True
    tiny = replace_masks(sample, small)
    assert report_of(tiny).least == pytest.approx(max(0.4, (1 - 1.5 / np.sqrt(36 / np.pi)) ** 2))
    assert report_of(replace_masks(sample, np.ones((120, 160), bool))).least == FITS["masks"]


def replace_masks(sample, mask):
    return replace(sample, instances=[replace(i, mask=mask) for i in sample.instances])
