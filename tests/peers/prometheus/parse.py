"""Parses OpenMetrics text from standard input with the parser of prometheus_client, and prints its samples as JSON.

The parser enforces the specification: names with their units and suffixes, one block for each metric family, no
duplicate series, the end mark.
"""

import json
import sys

from prometheus_client.openmetrics.parser import text_string_to_metric_families

families = list(text_string_to_metric_families(sys.stdin.read()))
print(json.dumps({
    "families": [{"name": f.name, "type": f.type, "unit": f.unit, "help": f.documentation} for f in families],
    "samples": [[s.name, s.labels, s.value] for f in families for s in f.samples],
}))
