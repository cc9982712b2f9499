"""What readers of files of other programs need: tables, what their columns are, how their time stamps are read.

`table/`: the rows of a text and what stands above them. `columns`: taxels, times, and columns that are neither.
`clock/`: stamps, their unit, and trials at one sampling rate. `formats/`: the door of formats. `doubts`: what looks
wrong. `naming`, `event_spec`: what users say. The readers are in the package beside this one.
"""
