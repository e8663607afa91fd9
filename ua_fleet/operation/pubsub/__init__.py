"""PubSub as the server shows it: the information model of OPC 10000-14 clause 9."""
