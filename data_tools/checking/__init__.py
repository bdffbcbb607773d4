"""Whether poses, cameras, models and images of a dataset belong together, and what is off if not.

The models are drawn with the stated poses and cameras and compared with masks, depth, boxes and
colours. Where they do not fit, the mistakes that people make are undone one at a time; the one
whose undoing repairs the data is named, with the numbers before and after.
"""

from data_tools.checking.diagnosis import check_dataset
from data_tools.checking.report import Finding, Report

__all__ = ["Finding", "Report", "check_dataset"]
