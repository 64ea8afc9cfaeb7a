"""7.4.3 on the ROS graph: Multi-frequency reference on the ROS graph."""

from __future__ import annotations

from vo2_studies.reproduce.claims import Context, Section
from vo2_studies.reproduce.graph_sections import integrated_section
from vo2_studies.reproduce.sections.chapter_7 import references

NUMBER, TITLE = "7.4.3", "Multi-frequency reference on the ROS graph"


def run(context: Context) -> Section:
    """Run the scenario; about 20 s."""
    return integrated_section(
        NUMBER, TITLE, references()["multi"], {"composite": 2.43, "polynomial": 4.35}, context
    )
