"""A site's MQTT broker: accounts, access rules, certificates, and the start of mosquitto.

In: names of hosts, robots and people. Out: mosquitto's files, account folders, and mosquitto itself. May import ``core`` and
``mqtt``.
"""
