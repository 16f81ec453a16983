"""One module per node: read the parameters, build the library's objects, subscribe, publish, serve.

In: topics and services. Out: topics and services. May import the library and the rest of ``ros`` but ``ros.commands``. The
files in ``nodes/`` start them.
"""
