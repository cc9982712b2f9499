"""Clocks: how time stamps are read (`units`, `stamps`, `shared`), and trials at one sampling rate (`trials`).

| stamps | are read as | doubt |
|---|---|---|
| the column's name, or the line below it, ends with a unit | in this unit | an option that gives another |
| whole numbers above 1e18 | nanoseconds since 1970 | |
| without a unit | seconds, else the one unit that gives touch (`units.timings`) | two do: refused |
| `12:00:00.25`, a date, AM and PM, `59:59.5` | seconds since midnight | a clock that goes back: refused |
| `sec` and `nanosec` | whole seconds and the rest | the rest is a second or more: refused |
| shared by rows | batches, spread evenly (`shared`) | uneven: refused; copies, or at most 5 %: dropped |
| a little off | jitter: interpolated | an interval of five usual ones: a gap, refused |
"""
