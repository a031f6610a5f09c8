"""Every question that a person asks, once: a typed request, a typed answer, progress.

The command line, the page and Python are views of these records. Modules import light; what computes is
imported with the first answer.
"""
