"""Accuracy of estimates: metrics, tables, error profiles, outliers, the paper's numbers."""
