"""When a network may decide early: the rule, its choice on validation windows, networks cut short."""
