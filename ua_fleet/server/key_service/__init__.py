"""The Security Key Service: keys of SecurityGroups for those who may have them (OPC 10000-14 section 8)."""
