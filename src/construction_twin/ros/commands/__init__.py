"""Commands that a person types: ``twin``, ``experiment``, ``scenario``, ``evaluate``, ``export_gateway_config``, ``new_arm``,
``preflight`` and the recorder behind them.

In: a command line, bags, a running system. Out: requests, recordings, reports, exit codes. May import the library and the rest
of ``ros``.
"""
