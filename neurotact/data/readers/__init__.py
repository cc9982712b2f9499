"""What readers of files of other programs need, here and in the package beside this one.

`table/`: the rows of a text and what stands above them. `columns`: taxels, times, and columns that are neither.
`clock/units`: how stamps are written. `formats/`: the door of formats. `specs`: what users say of files.
"""
