"""Evidence: the paper's experiments and every published number, measured by `python -m tests.bench`.

A section is a module with `jobs(size)`, which says what is to be measured, `lines(results)`, the section of the page, and
`pictures(results)`, its plots. Jobs are functions of plain values that return plain values: what they return is kept in a
file as it comes, and the page is made of that file alone.
"""
