"""Optional: sensor suites, and the senses that FireAntV3 lacks."""
