"""8.4.2 on the ROS graph: Multi-frequency reference on the ROS graph."""

from __future__ import annotations

from vo2_studies.reproduce.claims import Context, Section
from vo2_studies.reproduce.graph_sections import peltier_section
from vo2_studies.reproduce.sections.chapter_8_4 import published

NUMBER, TITLE = "8.4.2", "Multi-frequency reference on the ROS graph"


def run(context: Context) -> Section:
    """Run the scenario; about 30 s."""
    return peltier_section(NUMBER, TITLE, "multi", published("multi"), context)
