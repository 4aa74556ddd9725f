"""Messages of the graph to records of the core and back; no node, no middleware at run time."""
