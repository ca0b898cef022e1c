"""One page about a commissioning, made from what lies in its folder, however far it has come."""

from koop_commission.report.write import reported, write_report

__all__ = ["reported", "write_report"]
