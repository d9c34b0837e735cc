"""The report of a kit or a panel: one self-contained HTML file that shows the written files."""

from tactape_fab.report.page import REPORT_NAME, Written, render_report
from tactape_fab.report.panel_page import WrittenPanel, render_panel_report
from tactape_fab.report.written import add_panel_report, add_report

__all__ = ["REPORT_NAME", "Written", "WrittenPanel", "add_panel_report", "add_report", "render_panel_report", "render_report"]
