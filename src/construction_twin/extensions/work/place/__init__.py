"""The process `place`: an element is taken from its stock to its place with a tool that grips it.

In: a job, its recipe, the scene. Out: the segments of a work plan, or why there are none. `process` finds it by its name; nothing
outside of this folder imports it. May import what `work` imports, and the modules of ``work`` itself.
"""
