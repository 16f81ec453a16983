"""The MQTT link: client, joint string, JSON messages, accounts, and what a failed connection means.

In: joint positions with session, sequence number and stamp; payloads from the broker. Out: payloads and their parsed contents,
or a typed error for each malformed one. May import ``core`` and paho-mqtt. Runs on the cell PC.
"""
