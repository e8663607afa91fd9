"""The web console: an OPC UA client that logs in as the person who looks, and a page that shows what it sees.

    browser -- HTTP, one WebSocket --> app, live --> people (who is logged in) --> link (one OPC UA session) --> server

What is live is a *feed*: a map from keys to values, kept on a Board, of which each browser's PageOutbox sends what has
changed. What is asked for once is an *operation*. docs/console.md has both, with their forms.
"""
