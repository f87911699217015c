"""What faults with a date share: they happen once, before a row, and stay."""

from __future__ import annotations

from pcalib.settings import Setting

ROW = Setting("row", "whole", 1, 1.0, about="the first row after it, counted from 1 in the order of the plan")
