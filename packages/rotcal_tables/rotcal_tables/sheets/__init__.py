"""Tables of numbers as people have them: workbooks and texts, however they were exported.

``files`` reads a file as grids of cells, ``numerals`` reads cells as numbers, ``words`` knows the
names of columns and units in five languages, ``layout`` finds out which column is which,
``passes`` distinguishes visits of a table angle. ``reading`` makes the plain table that a
method reads, in metres and with numbers from 0, and says how it was understood. What can be read
in two ways is asked, never guessed.
"""
