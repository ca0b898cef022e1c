"""One page about a commissioning, made from what lies in its folder, however far it has come."""

from koop_commission.report.write import try_report, write_report

__all__ = ["try_report", "write_report"]
