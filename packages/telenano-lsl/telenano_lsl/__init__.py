"""The bridge of telenano to the Lab Streaming Layer."""
