"""The leaderboard: entries that were submitted, and the tables made from them.

It reads submissions and computes every number from the returns in them; it knows no agent and no torch.
"""
