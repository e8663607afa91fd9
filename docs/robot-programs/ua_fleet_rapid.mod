MODULE UaFleet
    ! The robot's side of ua_fleet's interpreter mode, framing `terminator` with a line feed.
    ! Runs as a background task (SEMISTATIC); the motion task reads `job_number` and does the work.
    ! Written from docs/tcp.md; it has not been run on a controller.

    ! Number of the job that is to be done, or was done last; survives a restart. A text, since a `num` is exact to
    ! 8388608 only, and the bridge's numbers go to 2147483647.
    PERS string job_number := "";
    PERS string job_skill := "";
    PERS num job_size := 0;
    PERS string job_data{8} := ["", "", "", "", "", "", "", ""];
    PERS string job_state := "done";   ! running, done, failed, halted; written by the motion task
    PERS bool job_halt := FALSE;       ! the motion task stops when this is set

    VAR socketdev listener;
    VAR socketdev bridge;
    VAR string told_state := "";       ! the state that was last sent to the bridge

    PROC main()
        SocketCreate listener;
        SocketBind listener, "192.168.125.1", 1025;
        SocketListen listener;
        WHILE TRUE DO
            SocketAccept listener, bridge \Time:=WAIT_MAX;
            serve;
            SocketClose bridge;
        ENDWHILE
    ENDPROC

    PROC serve()
        VAR string first;
        VAR bool heard;
        told_state := job_state;
        WHILE SocketGetStatus(bridge) = SOCKET_CONNECTED DO
            heard := wait_field(first);
            IF heard take first;
            IF job_state <> told_state tell job_number;
        ENDWHILE
    ERROR
        ! The bridge has disconnected; it sends its queries when it connects again.
        RETURN;
    ENDPROC

    ! One field, byte by byte: TCP may have cut it anywhere.
    FUNC string field()
        VAR string byte;
        VAR string text := "";
        SocketReceive bridge \Str:=byte \ReadNoOfBytes:=1 \Time:=2;
        WHILE byte <> "\0A" DO
            text := text + byte;
            SocketReceive bridge \Str:=byte \ReadNoOfBytes:=1 \Time:=2;
        ENDWHILE
        RETURN text;
    ENDFUNC

    ! Whether a message begins within 100 ms, and its first field.
    FUNC bool wait_field(INOUT string first)
        VAR string byte;
        SocketReceive bridge \Str:=byte \ReadNoOfBytes:=1 \Time:=0.1;
        first := byte + field();
        RETURN TRUE;
    ERROR
        IF ERRNO = ERR_SOCK_TIMEOUT RETURN FALSE;
        RAISE;
    ENDFUNC

    PROC take(string kind)
        VAR string subtype;
        VAR string number;
        VAR num size;
        VAR string data{8};
        VAR bool ok;
        subtype := field();
        number := field();
        ok := StrToVal(field(), size);
        FOR i FROM 1 TO size DO
            data{i} := field();
        ENDFOR
        TEST kind
        CASE "command", "request":
            IF job_state = "running" THEN
                send_text "busy", number, "the robot is at another job";
            ELSE
                job_skill := subtype;
                job_size := size;
                job_data := data;
                job_halt := FALSE;
                job_state := "running";
                job_number := number;   ! last: the motion task waits for it
                tell number;
            ENDIF
        CASE "query":
            IF number = job_number THEN
                tell number;
            ELSE
                send_text "unknown", number, "";
            ENDIF
        CASE "halt":
            IF number = job_number job_halt := TRUE;
        CASE "information":
            ! A value of the fleet: data{1} to data{size}.
        ENDTEST
    ENDPROC

    PROC tell(string number)
        told_state := job_state;
        send "status";
        send job_state;
        send number;
        IF job_state = "done" AND job_skill = "work" THEN
            send "2";
            send job_data{1};
            send job_data{2};
        ELSE
            send "0";
        ENDIF
    ENDPROC

    PROC send_text(string state, string number, string text)
        send "status";
        send state;
        send number;
        send "1";
        send text;
    ENDPROC

    PROC send(string text)
        SocketSend bridge \Str:=text + "\0A";
    ENDPROC
ENDMODULE
