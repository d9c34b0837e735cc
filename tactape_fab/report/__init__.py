"""The report of a kit: one HTML file that shows what was written, without a network."""

from tactape_fab.report.page import REPORT_NAME, Written, render_report
from tactape_fab.report.written import add_report

__all__ = ["REPORT_NAME", "Written", "add_report", "render_report"]
